"""Print the tables: python -m tests.cross_checks."""

from __future__ import annotations

from tests.cross_checks.tables import bad_hit_table, free_head_table, friction_table, held_table, sweep_table

for rows in (free_head_table(), bad_hit_table(), held_table(), friction_table(), sweep_table()):
    for row in rows:
        print(row, flush=True)
    print()
