"""Command `toolee arm`: slow motions of a bring-up."""
