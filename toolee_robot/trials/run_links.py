"""Links from a report of trials to what its jobs left."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from toolee_robot.trials.results import Record
from toolee_robot.trials.tasks import out_of


@dataclass(frozen=True)
class RunLinks:
    """Where a report and the folders of its jobs lie.

    Attributes:
        page: Folder of the report.
        trials: Folder of the trials, in which the jobs' folders are.
    """

    page: Path
    trials: Path

    def link(self, record: Record, words: str, file: str) -> Markup | str:
        """A link to a file of a job, where that is here: results may have come alone.

        Args:
            record: The job's result.
            words: What is clicked on.
            file: Name of the file in the job's folder.

        Returns:
            The link, relative to the report's folder; the words alone where the file is not here.
        """
        run = Path(record.figures.get("run_folder") or "").name
        if run in ("", ".."):  # a file of results may say anything
            return words
        place = out_of(record.trial, self.trials) / run / file
        if not place.is_file():
            return words
        way = Path(os.path.relpath(place.resolve(), self.page.resolve())).as_posix()
        return Markup('<a href="{0}">{1}</a>').format(quote(way), words)
