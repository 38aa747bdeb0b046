"""The page of `toolee annotate`: what a ray means, and a person's clicks in a real browser."""

from __future__ import annotations

import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote
from urllib.request import Request

import numpy as np
import pytest
import viser
from websockets import Origin, Subprotocol
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from tests.perception.data_sets import held_out_tools
from tests.perception.offline.annotation.scenes import RenderedEnd, rendered_ends
from tests.viewer.browser import ARGUMENTS, CHROMIUM
from toolee_robot.perception.offline.annotation.clicks import (
    ClickedEnd,
    ClickedFrame,
    ClicksFile,
    Role,
    Shape,
    read_clicks,
    write_clicks,
)
from toolee_robot.perception.offline.annotation.frame_set import FrameSet, Session
from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd
from toolee_robot.viewer.annotation_page import AnnotationPage
from toolee_robot.viewer.annotation_scene import LARGEST_MESSAGE, MARGIN

pytestmark = pytest.mark.sim(seconds=20)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return held_out_tools(tmp_path_factory)


@pytest.fixture
def face(data: Path) -> RenderedEnd:
    return next(e for e in rendered_ends(data, "test") if e.clicked.shape is Shape.FACE)


@pytest.fixture
def page(data: Path, face: RenderedEnd, tmp_path: Path) -> Iterator[tuple[AnnotationPage, Session]]:
    folder = shutil.copytree(data / "test" / "000000", tmp_path / "frames")
    session = Session(FrameSet(folder))
    session.look_at(session.frames.names.index(face.name))
    made = AnnotationPage(session, 8330)
    yield made, session
    made.close()


def _until(holds: Callable[[], bool], seconds: float = 30.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and not holds():
        time.sleep(0.05)
    return holds()


def test_a_ray_means_the_pixel_that_it_meets(page: tuple[AnnotationPage, Session]) -> None:
    scene, session = page[0].scene, page[1]
    frame = session.annotated.frame
    k, depth = frame.intrinsics, frame.depth
    u, v = 300.0, 120.0
    at = np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    for eye in (np.zeros(3), np.array([0.1, -0.2, 0.4])):
        assert scene.pixel_of(eye, 3.0 * (at - eye)) == pytest.approx((u, v))
    assert scene.pixel_of(np.zeros(3), np.array([0.0, 0.0, -1.0])) is None
    scene.look("cloud")
    rows, columns = np.nonzero(depth > 0)
    n = len(rows) // 2
    z = float(depth[rows[n], columns[n]])
    point = np.array([(columns[n] - k.cx) / k.fx * z, (rows[n] - k.cy) / k.fy * z, z])
    assert scene.pixel_of(np.zeros(3), point) == pytest.approx((columns[n], rows[n]), abs=1.0)


def test_another_site_or_somebody_without_the_token_gets_nothing(page: tuple[AnnotationPage, Session]) -> None:
    address = page[0].address
    site, token, _ = address.rsplit("/", 2)
    for asked in (Request(address, headers={"Host": "evil.example:8080"}), site, f"{site}/{token[:-1]}/", f"{site}/é/"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(asked if isinstance(asked, Request) else quote(asked, safe=":/"))
    viser_s = [Subprotocol(f"viser-v{viser.__version__}")]
    socket = address.replace("http", "ws", 1).removesuffix("/")  # as the page asks for it
    for where, origin in ((socket, "http://evil.example"), (site.replace("http", "ws", 1), site)):
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(where, origin=Origin(origin), subprotocols=viser_s),
        ):
            pass
    with connect(socket, origin=Origin(site), subprotocols=viser_s, max_size=None) as own:
        assert own.recv(timeout=30.0)
        own.send(bytes(LARGEST_MESSAGE + 1))
        with pytest.raises(ConnectionClosedError, match="too big"):
            list(own)


def test_it_tells_the_pose_its_checks_and_what_is_missing(
    page: tuple[AnnotationPage, Session], face: RenderedEnd
) -> None:
    made, session = page
    with urllib.request.urlopen(made.address) as served:
        assert b"<html" in served.read(2000)
    ends = (face.clicked, ClickedEnd(Shape.TIP))
    clicks = ClicksFile("bench", frames={face.name: ClickedFrame(ends=ends)})
    write_clicks(session.frames.folder / "clicks.yaml", clicks)
    again = Session(FrameSet(session.frames.folder))
    again.look_at(session.number)
    other = AnnotationPage(again, 8331)
    try:
        assert "0 of 1 clicks of the kind tip" in other.text
        again.choose_end(0)
        again.enter(tape_mm=1500.0)
        again.enter_tape_offset(0.0)
        other.refresh()
        assert "hammer face: ± " in other.text
        assert "disagrees: the pose is not used" in other.text
        assert "| rim |" in other.text
    finally:
        other.close()


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_a_person_clicks_a_face_in_the_browser(page: tuple[AnnotationPage, Session], face: RenderedEnd) -> None:
    from playwright.sync_api import sync_playwright

    made, session = page
    size = np.array(session.annotated.frame.depth.shape[::-1])
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        view = browser.new_page(viewport={"width": 1400, "height": 1000})
        view.goto(made.address)
        view.get_by_text("looked at").wait_for(timeout=60_000)
        view.wait_for_timeout(5_000)  # software rendering: the photograph appears
        box: Any = view.locator("canvas").first.bounding_box()
        canvas = np.array([box["width"], box["height"]])
        scale = float((canvas / size).min()) / MARGIN

        def click(u: float, v: float) -> None:
            x, y = [box["x"], box["y"]] + canvas / 2 + scale * (np.array([u, v]) - (size - 1) / 2)
            before = len(session.current.clicks) if session.current is not None else 0
            view.mouse.click(float(x), float(y))
            assert _until(lambda: session.current is not None and len(session.current.clicks) == before + 1)

        view.get_by_role("button", name="add", exact=True).click()
        assert _until(lambda: session.current == ClickedEnd(Shape.FACE))
        for wanted in face.clicked.clicks:
            click(wanted.u, wanted.v)
        assert session.current is not None
        for made_click, wanted in zip(session.current.clicks, face.clicked.clicks, strict=True):
            assert made_click.role is wanted.role, "the page asks for the next kind of click by itself"
            assert np.hypot(made_click.u - wanted.u, made_click.v - wanted.v) < 1.0
        view.get_by_text("hammer face: ±").wait_for(timeout=30_000)
        (end,) = session.annotated.ends
        assert isinstance(end, AnnotatedEnd)
        assert np.linalg.norm(end.fit.X_camera_ee[:3, 3] - face.X_camera_ee[:3, 3]) < 3e-3 * end.sigma_mm
        view.get_by_role("button", name="Undo the last click").click()
        assert _until(
            lambda: session.current is not None and len(session.current.clicks) == len(face.clicked.clicks) - 1
        )
        view.get_by_role("button", name="cloud", exact=True).click()
        view.wait_for_timeout(3_000)
        view.mouse.click(float(box["x"] + canvas[0] / 2), float(box["y"] + canvas[1] / 2))
        assert _until(lambda: session.current is not None and len(session.current.clicks) == len(face.clicked.clicks))
        saved = read_clicks(session.frames.folder / "clicks.yaml").frames[face.name].ends[0]
        assert saved == session.current
        last = saved.clicks[-1]
        middle = np.mean([[c.u, c.v] for c in face.clicked.clicks if c.role is not Role.HANDLE], axis=0)
        assert np.hypot(*(np.array([last.u, last.v]) - middle)) < 6.0, "the cloud turns about the clicks"
        browser.close()
