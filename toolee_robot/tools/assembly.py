"""From overlapping pieces to a Tool: one outer surface, and what each piece is made of."""

from __future__ import annotations

from toolee_robot.tools.model import EndEffector, Handle, SolidPart, Tool, ToolKind, tool_name
from toolee_robot.tools.solids import Piece, unite


def assemble(kind: ToolKind, seed: int, pieces: list[Piece], ees: tuple[EndEffector, ...], handle: Handle) -> Tool:
    """Where two pieces overlap, the later one keeps the volume (a handle fills the eye of its head)."""
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
