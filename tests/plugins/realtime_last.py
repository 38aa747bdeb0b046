"""The order in which pytest-xdist's workers get the files of tests: those bound to the wall clock last, alone."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

BOUND = ("realtime", "light")
"""What is bound to the clock: what needs a machine that does nothing else, and what may run beside it."""
_FEWEST = 4
"""Workers of which two wait: at least as many run what is not bound to the clock."""


@dataclass
class _Share:
    """What one worker runs when the processes of all that do not wait have ended."""

    files: frozenset[str]
    worker: WorkerController | None = None


class RealtimeLast(LoadFileScheduling):
    """Whole files go to the workers; those marked `realtime` follow after all others, on one or two workers."""

    collection: list[str] | None
    workqueue: OrderedDict[str, dict[str, bool]]

    def __init__(self, config: pytest.Config, log: Producer | None, tiers: Path) -> None:
        super().__init__(config, log)
        self._tiers = tiers
        self._bound: dict[str, str] = {}
        self._shares: list[_Share] = []

    def schedule(self) -> None:
        """Called when all workers have collected, and again when one has that replaces a crashed one."""
        if self.collection is None:
            if not self._check_nodes_have_same_collection():
                return
            self.collection = list(next(iter(self.registered_collections.values())))
            self._fill_queue()
        for share in self._shares:
            if share.worker is None and any(file in share.files for file in self.workqueue):
                free = [node for node in self.nodes if self._share(node) is None and not node.shutting_down]
                # The one started last, whichever has collected first.
                share.worker = max(free, key=lambda node: int(node.gateway.id.removeprefix("gw")), default=None)
        self._reschedule_all()

    def remove_node(self, node: WorkerController) -> str | None:
        share = self._share(node)
        if share is not None:
            share.worker = None
        crashed_in = super().remove_node(node)
        self._reschedule_all()
        return crashed_in

    def _fill_queue(self) -> None:
        tiers: dict[str, dict[str, float]] = json.loads(self._tiers.read_text())
        self._bound = {nodeid: tier for tier in BOUND for nodeid in tiers[tier]}
        seconds = {**tiers["unit"], **tiers["sim"]}

        def order(file: tuple[str, dict[str, bool]]) -> tuple[float, int]:
            """The longest first, so that all workers end at about the same time."""
            return -max(seconds[nodeid] for nodeid in file[1]), -len(file[1])

        self.workqueue.update(sorted(self._files(seconds).items(), key=order))
        bound = [files for tier in BOUND if (files := self._files(tiers[tier]))]
        for files in bound:
            self.workqueue.update(files)
        if len(self.nodes) >= _FEWEST:
            self._shares = [_Share(frozenset(files)) for files in bound]
        elif len(self.nodes) > 1 and bound:
            self._shares = [_Share(frozenset().union(*bound))]

    def _split_scope(self, nodeid: str) -> str:
        """The file; its tests that are bound to the clock are a group of their own, and the light ones another."""
        file = super()._split_scope(nodeid)
        return f"{file} ({self._bound[nodeid]})" if nodeid in self._bound else file

    def _files(self, nodeids: Iterable[str]) -> OrderedDict[str, dict[str, bool]]:
        """Their tests by file, none of them done."""
        files: OrderedDict[str, dict[str, bool]] = OrderedDict()
        for nodeid in nodeids:
            files.setdefault(self._split_scope(nodeid), {})[nodeid] = False
        return files

    def _share(self, node: WorkerController) -> _Share | None:
        return next((share for share in self._shares if share.worker is node), None)

    def _next_file(self, share: _Share | None) -> str | None:
        """The first one in the queue of this share, or of what nobody waits for."""
        kept = frozenset[str]().union(*(share.files for share in self._shares))
        return next((file for file in self.workqueue if (file in share.files if share else file not in kept)), None)

    def _waits(self) -> bool:
        """Whether there is work left for those that do not wait, or any of their processes."""
        return self._next_file(None) is not None or any(self._share(node) is None for node in self.nodes)

    def _reschedule_all(self) -> None:
        for node in self.nodes:
            self._reschedule(node)

    def _reschedule(self, node: WorkerController) -> None:
        if node.shutting_down or node not in self.registered_collections:
            return
        share = self._share(node)
        if share is not None and self._waits():
            return
        # A worker starts a test when it knows what follows: another one, or the end.
        while (file := self._next_file(share)) is not None and self._pending_of(self.assigned_work[node]) <= 2:
            self.workqueue.move_to_end(file, last=False)  # from where it is taken
            self._assign_work_unit(node)
        if file is None:
            node.shutdown()
