"""The report of an evaluation: its pages, tables and pictures."""
