"""The order in which pytest-xdist's workers get the files of tests: those bound to the wall clock last, alone."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController


class RealtimeLast(LoadFileScheduling):
    """Whole files go to the workers, as with `--dist loadfile`, but one worker waits until the processes of all others
    have ended. Then it runs the tests marked `realtime`, one after another, on a machine that does nothing else and in
    a process that has run no other test. Where nothing is marked so, it works like the others; a single worker runs
    the tests marked `realtime` after all others.

    Args:
        config: of the controlling process.
        log: xdist's debug log.
        tiers: a file that the workers have written when they have collected: JSON, `{tier: {node id: seconds}}`, with
            what the marker says of how long the test's file takes. (What a worker tells of its collection is the node
            ids, without markers.)
    """

    collection: list[str] | None
    workqueue: OrderedDict[str, dict[str, bool]]

    def __init__(self, config: pytest.Config, log: Producer | None, tiers: Path) -> None:
        super().__init__(config, log)
        self._tiers = tiers
        self._bound: frozenset[str] = frozenset()
        self._realtime: OrderedDict[str, dict[str, bool]] = OrderedDict()
        self._waiting: WorkerController | None = None

    @property
    def tests_finished(self) -> bool:
        return not self._realtime and super().tests_finished

    @property
    def has_pending(self) -> bool:
        return bool(self._realtime) or super().has_pending

    def schedule(self) -> None:
        """Called when all workers have collected, and again when one has that replaces a crashed one."""
        if self.collection is None:
            if not self._check_nodes_have_same_collection():
                return
            self.collection = list(next(iter(self.registered_collections.values())))
            self._fill_queues()
        if self._realtime and self._waiting is None:
            self._waiting = self.nodes[-1]
        for node in self.nodes:
            self._reschedule(node)
        self._start_realtime()

    def remove_node(self, node: WorkerController) -> str | None:
        if node is self._waiting:
            self._waiting = None
        crashed_in = super().remove_node(node)
        self._start_realtime()
        return crashed_in

    def _fill_queues(self) -> None:
        tiers: dict[str, dict[str, float]] = json.loads(self._tiers.read_text())
        self._bound = frozenset(tiers["realtime"])
        seconds = {**tiers["unit"], **tiers["sim"]}

        def order(file: tuple[str, dict[str, bool]]) -> tuple[float, int]:
            """The longest first, so that all workers end at about the same time."""
            return -max(seconds[nodeid] for nodeid in file[1]), -len(file[1])

        self.workqueue.update(sorted(self._files(seconds).items(), key=order))
        self._realtime = self._files(tiers["realtime"])
        if len(self.nodes) == 1:
            self.workqueue.update(self._realtime)
            self._realtime = OrderedDict()

    def _split_scope(self, nodeid: str) -> str:
        """The file; its tests that are bound to the clock are a group of their own."""
        file = super()._split_scope(nodeid)
        return f"{file} (realtime)" if nodeid in self._bound else file

    def _files(self, nodeids: Iterable[str]) -> OrderedDict[str, dict[str, bool]]:
        """Their tests by file, none of them done."""
        files: OrderedDict[str, dict[str, bool]] = OrderedDict()
        for nodeid in nodeids:
            files.setdefault(self._split_scope(nodeid), {})[nodeid] = False
        return files

    def _reschedule(self, node: WorkerController) -> None:
        if node is self._waiting or node.shutting_down or node not in self.registered_collections:
            return
        # A worker starts a test when it knows what follows: another one, or the end.
        while self.workqueue and self._pending_of(self.assigned_work[node]) <= 2:
            self._assign_work_unit(node)
        if not self.workqueue:
            node.shutdown()

    def _start_realtime(self) -> None:
        """If the worker that waits for it is the only one left."""
        if self._realtime and not self.workqueue and self.nodes == [self._waiting]:
            node, self._waiting = self.nodes[0], None
            self.workqueue, self._realtime = self._realtime, OrderedDict()
            self._reschedule(node)
