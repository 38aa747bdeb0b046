"""The page of a run: what it says and shows at a time, replayed and live."""

from __future__ import annotations

import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.recording import small_run
from tests.viewer.browser import CHROMIUM, MOST_MESSAGES, MOST_RECEIVED, MOST_SERVED, browser
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.reading import read_history
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import load_robot
from toolee_robot.station import StationConfig
from toolee_robot.viewer.run_page import WORDS, RunPage


def _until(holds: Callable[[], bool], seconds: float = 20.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(0.05)
    return holds()


def _place(page: RunPage, link: str) -> Any:
    return page.scene.picture.place(link)


@pytest.mark.sim(seconds=10)
def test_it_shows_the_run_at_a_time_and_plays(tmp_path: Path) -> None:
    history = read_history(small_run.write(tmp_path / "run.mcap"))
    page = RunPage(history, history.station(), 8310)
    try:
        with urllib.request.urlopen(page.address) as served:
            assert b"<html" in served.read(2000)
        assert "Handover" in page.text
        assert "20.0 mm over the wood" in page.text
        page.seek(2.0)
        description = load_robot()
        expected = description.link_poses(small_run.REACHED, description.hand_open)["forearm_link"][:3, 3]
        assert _until(lambda: np.allclose(_place(page, "forearm_link"), expected, atol=1e-6))
        before = _place(page, "nail head nail")
        page.seek(4.2)
        assert _until(lambda: "12.3 mm over the wood" in page.text)
        assert "strike 1: expected, 12.3 mm left, 54 N" in page.text
        assert "the nail went in" in page.text
        sunk = _place(page, "nail head nail") - before
        assert sunk[2] == pytest.approx(-0.0077, abs=1e-6), "the nail goes down with the hammer's strikes"
        page.seek(0.0)
        page.play()
        assert _until(lambda: "Flush" in page.text), "it plays to the end in 4.3 s"
        assert [d.name for d in page.decisions] == ["stage", "stage", "pose_in_hand", "stage", "strike", "ended"]
    finally:
        page.close()


@pytest.mark.sim(seconds=10)
def test_it_follows_a_job_that_runs(tmp_path: Path) -> None:
    page = RunPage(RunHistory(complete=False), StationConfig(), 8310, live=True)
    try:
        assert "Connecting" in page.text
        page.prompt("Lay the hammer into the open hand.")
        assert "➤ Lay the hammer into the open hand." in page.text
        with RunRecorder(tmp_path / "run.mcap", {"X_hand_ee": np.eye(4), "X_tool_ee": np.eye(4)}) as recorder:
            page.follow(recorder)
            small_run.record(recorder)
            assert _until(lambda: "Flush" in page.text)
        assert "➤" not in page.text, "the job has gone on"
        assert "12.3 mm over the wood" in page.text
    finally:
        page.close()


@pytest.mark.nightly
@pytest.mark.sim(seconds=20)
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_a_browser_is_sent_little_until_the_page_is_there_and_nothing_while_it_stands(tmp_path: Path) -> None:
    history = read_history(small_run.write(tmp_path / "run.mcap"))
    page = RunPage(history, history.station(), 8310)
    try:
        with browser() as seen:
            seconds = seen.load(page.address, "20.0 mm over the wood")
            print(f"there in {seconds:.1f} s: {seen.served} B of files, {seen.received} B in {seen.messages} messages")
            assert 0 < seen.served < MOST_SERVED
            assert 0 < seen.received < MOST_RECEIVED
            assert seen.messages <= MOST_MESSAGES
            messages = seen.messages
            seen.view.wait_for_timeout(1_000)
            assert seen.messages == messages
            seen.view.get_by_role("button", name="Play", exact=True).click()
            seen.view.get_by_role("heading", name="Flush", exact=True).wait_for(timeout=60_000)
            assert seen.messages > messages + 15, "it plays"
    finally:
        page.close()


@pytest.mark.sim(seconds=20)
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_a_browser_shows_prompts_and_stages_of_a_job_that_runs(tmp_path: Path) -> None:
    page = RunPage(RunHistory(complete=False), StationConfig(), 8310, live=True)
    try:
        with browser() as seen, RunRecorder(tmp_path / "run.mcap", {"X_hand_ee": np.eye(4)}) as recorder:
            seen.load(page.address, "Connecting")
            page.prompt("Lay the hammer into the open hand.")
            prompt = seen.view.get_by_text("➤ Lay the hammer into the open hand.")
            prompt.wait_for(timeout=60_000)
            page.follow(recorder)
            messages = seen.messages
            small_run.record(recorder)
            seen.view.get_by_role("heading", name="Flush", exact=True).wait_for(timeout=60_000)
            assert prompt.count() == 0, "the job has gone on"
            assert seen.messages > messages + 5, "the robot moves"
            page.play(False)
            for stamp, stage in ((0.2, "handover"), (2.5, "perceive"), (3.5, "strike")):
                page.seek(stamp)
                seen.view.get_by_role("heading", name=WORDS[stage], exact=True).wait_for(timeout=60_000)
    finally:
        page.close()
