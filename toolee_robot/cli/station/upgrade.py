"""`toolee station upgrade`: a station file of version 1 becomes one of version 2."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.errors import UserError
from toolee_robot.runtime.files import written_whole
from toolee_robot.runtime.yaml_edit import add_first, set_fields
from toolee_robot.runtime.yaml_lines import YamlLines
from toolee_robot.station import VERSION, is_current, read_station
from toolee_robot.station.station import to_station


@dataclass(frozen=True)
class Upgrade:
    """Rewrite a station file of version 1 as version 2, and name what it lacks. It invents no value.

    Example: toolee station upgrade lab.yaml

    The file as it was is kept beside it, as lab.yaml.v1. Comments, order, layout and permissions stay. Of a symbolic
    link, the file that it leads to is rewritten, and kept beside that.

    Exit code 0: the file is of version 2, and complete but for what commands measure; 1: fields are open, and listed;
    2: the file is invalid, and was not changed.
    """

    file: tyro.conf.Positional[Path]
    """The station file."""

    def run(self) -> int:
        console = Console(highlight=False)
        data = read_station(self.file)
        name = f"[bold]{escape(str(self.file))}[/bold]"
        if is_current(data, self.file):
            console.print(f"{name} is of version {VERSION} already: nothing was changed.", soft_wrap=True)
            return 0
        to_station(data, self.file)  # a file that is wrong is corrected before it is rewritten
        kept = self._keep()
        try:
            if "version" in data:
                set_fields(self.file, (), {"version": VERSION})
            else:
                add_first(self.file, "version", VERSION)
        except BaseException:
            kept.unlink()
            raise
        console.print(
            f"{name} is of version {VERSION} now. Changed: version: {VERSION} "
            f"({YamlLines(self.file).told(['version'])}). As it was: {escape(str(kept))}.",
            soft_wrap=True,
        )
        return self._missing(console)

    def _keep(self) -> Path:
        """Copy the file; returns the copy."""
        file = self.file.resolve() if self.file.is_symlink() else self.file
        kept = file.with_name(f"{file.name}.v1")
        if kept.exists():
            raise UserError(f"{kept} is there already: move it away, it is not overwritten", code="user.copy_exists")
        with written_whole(kept) as scratch:
            scratch.touch(mode=0o600)  # nobody reads it before it has the file's permissions
            shutil.copy(file, scratch)
        return kept

    def _missing(self, console: Console) -> int:
        from toolee_robot.stations.open_fields import open_fields

        lines, typed = YamlLines(self.file), False
        needed = [entry for entry in open_fields(read_station(self.file), self.file) if not entry.note]
        if needed:
            console.print(f"\n[bold]Version {VERSION} wants, and the file does not say[/bold]")
        for entry in needed:
            where = lines.told([*entry.section.split("."), entry.names[0]])
            section = f" ({where})" if where else ""
            source = f"from: {entry.source}" if entry.typed else entry.source
            console.print(f"  {escape(entry.fields)}{escape(section)}\n    {escape(source)}", soft_wrap=True)
            typed |= entry.typed
        if typed:
            console.print(f"\nNext: `toolee station new {escape(str(self.file))}` asks for these.", soft_wrap=True)
        else:
            console.print(f"\nNext: `toolee station check {escape(str(self.file))}`.", soft_wrap=True)
        return int(typed)
