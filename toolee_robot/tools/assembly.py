"""Assembly of overlapping pieces into a `Tool` with one outer surface and one material per part."""

from __future__ import annotations

from toolee_robot.tools.model import EndEffector, Handle, SolidPart, Tool, ToolKind, tool_name
from toolee_robot.tools.solids import Piece, unite


def assemble(kind: ToolKind, seed: int, pieces: list[Piece], ees: tuple[EndEffector, ...], handle: Handle) -> Tool:
    """Unite overlapping pieces into a tool.

    Where two pieces overlap, the volume belongs to the later one: a handle fills the eye of its head.

    Args:
        kind: Kind of the tool.
        seed: Seed of the tool, 0 or more.
        pieces: Solids in the `tool` frame [m].
        ees: End effectors, the working end first.
        handle: Grippable section of the tool.

    Returns:
        The tool; its parts have the order of `pieces`.
    """
    mesh, owner = unite([piece.solid for piece in pieces])
    later = [tuple(piece.solid for piece in pieces[i + 1 :]) for i in range(len(pieces))]
    return Tool(
        name=tool_name(kind, seed),
        kind=kind,
        seed=seed,
        parts=tuple(SolidPart(p.label, p.material, p.solid, others) for p, others in zip(pieces, later, strict=True)),
        mesh=mesh,
        face_parts=owner,
        ees=ees,
        handle=handle,
        _convex=tuple((piece.label, convex) for piece in pieces for convex in piece.convex),
    )
