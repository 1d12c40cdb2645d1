"""Evaluates the fitted BSDF of a JSON file as a BRDF, for slices, comparisons and tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core.directions import require_directions, rotate_z
from manifold.core.records import Array, Bands
from manifold.render import fit_json
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import BsdfFamily

_BLOCK = 1 << 18  # pairs that are evaluated at once: 100 MB


class FittedBRDF:
    """A fitted BSDF in linear sRGB, or in bands if its colours were fitted per band; it cannot be sampled."""

    def __init__(self, content: Mapping[str, Any]):
        """Take the content of a fit's JSON; see `fit_json.read`."""
        self._family = BsdfFamily.from_json(content["bsdf"])
        self._values = dict(content["values"])
        self._rotation_rad = float(np.deg2rad(content.get("rotation_deg", 0.0)))
        self._bands = Bands(None)
        if content["spectra"] is not None:
            self._values |= content["spectra"]["values"]
            self._bands = Bands(tuple(float(w) for w in content["spectra"]["wavelengths_nm"]))

    @classmethod
    def of(
        cls, family: BsdfFamily, values: Mapping[str, Any], bands: Bands, spectra: Mapping[str, Any],
        rotation_deg: float = 0.0,
    ) -> FittedBRDF:  # fmt: skip
        """Return the BRDF of fitted values, turned by an azimuth.

        `spectra` holds values per band; if it is empty, the BRDF is in linear sRGB.
        """
        known = {"wavelengths_nm": bands.wavelengths_nm, "values": spectra} if spectra else None
        return cls(
            {"bsdf": family.to_json(), "values": values, "spectra": known, "rotation_deg": rotation_deg}
        )

    @classmethod
    def read(cls, path: Path) -> FittedBRDF:
        """Read the fit of a JSON file."""
        return cls(fit_json.read(path))

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._bands

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        known = {**self._family.fixed, **self._values}
        return not known.get("anisotropic") and known.get("alpha_u") == known.get("alpha_v")

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B), for unit vectors (..., 3) that broadcast."""
        wi, wo = np.broadcast_arrays(require_directions(wi, "wi"), require_directions(wo, "wo"))
        flat_i, flat_o = (rotate_z(w.reshape(-1, 3), -self._rotation_rad) for w in (wi, wo))
        f_cos = np.empty((len(flat_i), self._bands.count))
        for first in range(0, len(flat_i), _BLOCK):
            pairs = slice(first, first + _BLOCK)
            here = evaluator(self._family, flat_i[pairs], flat_o[pairs], self._bands.count)
            f_cos[pairs] = here.values(here.layout.join(self._values))[0]
        f_cos[(flat_i[:, 2] <= 0) | (flat_o[:, 2] <= 0)] = 0.0
        return f_cos.reshape(*wi.shape[:-1], self._bands.count)

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction that is not above the horizon."""
        cos_o = np.asarray(wo)[..., 2:]
        f_cos = self.eval_cos(wi, wo)
        return np.divide(f_cos, cos_o, out=np.zeros_like(f_cos), where=cos_o > 0)
