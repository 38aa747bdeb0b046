"""The order in which pytest-xdist's workers get the files of tests: those bound to the wall clock first, the rest
beside them at the lowest priority."""

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

BOUND = ("alone", "realtime", "light")
"""What is bound to the clock: what needs a machine that does nothing else, what runs one at a time, and what may run
beside that."""
_FEWEST = 3
"""Workers of which two begin with what is bound to the clock: at least one begins with the rest."""


@dataclass
class _Share:
    """What one worker runs before all else.

    Attributes:
        files: Their names in the queue.
        worker: The one that runs it; none where it died and its successor is not there yet.
    """

    files: frozenset[str]
    worker: WorkerController | None = None


class RealtimeFirst(LoadFileScheduling):
    """Whole files go to the workers, as with `--dist loadfile`, but two workers begin with what is bound to the clock,
    in processes that have run no other test: one with the tests marked `realtime`, one after another, and the other
    one, at the same time, with those marked `realtime(light=True)`, one after another. The others run the rest
    meanwhile, and give way (`tiers.give_way`); those two help when they are through. All wait for the tests marked
    `realtime(alone=True)`, the very first. Of two workers one begins with all that is bound to the clock, the light
    ones last; a single one does, too.

    Args:
        config: of the controlling process.
        log: xdist's debug log.
        tiers: a file that the workers have written when they have collected: JSON, `{tier: {node id: seconds}}`, with
            what the marker says of how long the test's file takes; `alone` and `light` are tiers of their own. (What a
            worker tells of its collection is the node ids, without markers.)
    """

    collection: list[str] | None
    workqueue: OrderedDict[str, dict[str, bool]]

    def __init__(self, config: pytest.Config, log: Producer | None, tiers: Path) -> None:
        super().__init__(config, log)
        self._tiers = tiers
        self._bound: dict[str, str] = {}
        self._alone: set[str] = set()
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

    def mark_test_complete(self, node: WorkerController, item_index: int, duration: float = 0) -> None:
        super().mark_test_complete(node, item_index, duration)
        nodeid = self.registered_collections[node][item_index]
        if nodeid in self._alone:
            self._alone.remove(nodeid)
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
        self._alone = set(tiers["alone"])
        seconds = {**tiers["unit"], **tiers["sim"]}

        def order(file: tuple[str, dict[str, bool]]) -> tuple[float, int]:
            """The longest first, so that all workers end at about the same time."""
            return -max(seconds[nodeid] for nodeid in file[1]), -len(file[1])

        single, light = self._files([*tiers["alone"], *tiers["realtime"]]), self._files(tiers["light"])
        for files in (single, light, OrderedDict(sorted(self._files(seconds).items(), key=order))):
            self.workqueue.update(files)
        shares = [single, light] if len(self.nodes) >= _FEWEST else [single | light]
        self._shares = [_Share(frozenset(files)) for files in shares if files]

    def _split_scope(self, nodeid: str) -> str:
        """The file; its tests of each kind that is bound to the clock are a group of their own."""
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
        """The first one in the queue of this share, or else of what is in none."""
        kept = frozenset[str]().union(*(other.files for other in self._shares))
        own = (file for file in self.workqueue if share and file in share.files)
        return next(own, next((file for file in self.workqueue if file not in kept), None))

    def _waits(self, share: _Share | None) -> bool:
        """For a test that another worker runs alone."""
        return bool(self._alone) and not (share and any(self._split_scope(test) in share.files for test in self._alone))

    def _reschedule_all(self) -> None:
        for node in self.nodes:
            self._reschedule(node)

    def _reschedule(self, node: WorkerController) -> None:
        if node.shutting_down or node not in self.registered_collections:
            return
        share = self._share(node)
        if self._waits(share):
            return
        # A worker starts a test when it knows what follows: another one, or the end.
        while (file := self._next_file(share)) is not None and self._pending_of(self.assigned_work[node]) <= 2:
            self.workqueue.move_to_end(file, last=False)  # from where it is taken
            self._assign_work_unit(node)
        if file is None:
            node.shutdown()
