"""Record of what a hand's efforts mean, for a hand whose maker does not say so."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class HandEfforts:
    """Efforts of a hand's motors, in the unit in which it reports them. No field has a default: a lab measures them."""

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    touch: float
    """Effort above which a motor counts as touching; more than any has while its finger moves freely."""
    grip: float
    """Effort at which a motor stops to close further."""
    newtons_per_unit: float
    """Force at the fingertip by the effort [N]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) <= 0.0:
                raise ValueError(f"{field.name} must be more than 0")
        if self.grip <= self.touch:
            raise ValueError("grip must be more than touch")
