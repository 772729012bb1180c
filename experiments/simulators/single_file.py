"""`export_model`: a model as one file of MuJoCo or URDF, and in words what that file does not hold."""

from __future__ import annotations

from daq import Limits
from experiments.models import Model
from experiments.simulators.mjcf import mjcf_notes, mjcf_of
from experiments.simulators.parts import parts_of
from experiments.simulators.urdf import limits_of, urdf_notes, urdf_of


def export_model(model: Model, kind: str, where: str, limits: Limits | None = None) -> tuple[str, list[str]]:
    """(XML text, what of the model it does not hold or holds otherwise). `limits` are those of a rig, for URDF. Raises
    `InputError`."""
    parts = parts_of(model, where)
    if kind == "urdf":
        notes = urdf_notes(parts, limits is not None)
        return urdf_of(parts, notes, limits_of(limits, parts) if limits else ()), notes
    notes = mjcf_notes(parts)
    lost = [effect.name for effect in parts.left] + (["structure"] if model.structure else [])
    if lost:
        notes.append(f"MJCF cannot hold these effects of the model, they are left out: {', '.join(lost)}; "
                     "--to mujoco adds a module with them")
    return mjcf_of(parts, notes), notes
