"""The kinds of latent space, by name."""

from __future__ import annotations

from manifold.model.blend_space import BlendSpace
from manifold.model.curve_space import CurveSpace
from manifold.model.latent_space import LatentSpace
from manifold.model.material_space import MaterialSpace

SPACES: dict[str, type[LatentSpace]] = {
    space.kind: space for space in (BlendSpace, CurveSpace, MaterialSpace)
}
