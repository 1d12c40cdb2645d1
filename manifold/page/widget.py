"""The page as a notebook widget, through anywidget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import numpy as np

from manifold.colour.reflectances import ReflectanceSpectrum
from manifold.core.errors import UsageError
from manifold.core.extras import require
from manifold.model.colours import ColourChoice
from manifold.model.manifold import Manifold
from manifold.model.prediction import PredictedBRDF
from manifold.page.page import widget_module
from manifold.page.page_data import tabulate, to_document
from manifold.surface.written import read_surface

AnyWidget: Any = require("anywidget").AnyWidget
traitlets: Any = require("traitlets")


class MapWidget(AnyWidget):  # type: ignore[misc]
    """A notebook widget that shows a map of blends with a movable point.

    Attributes:
        latent: latent of the point, Q numbers; set it to move the point.
        colour: given colour: empty, `like`, `srgb`, or `spectrum` (rows of nm and reflectance); for a walk `between`,
            two materials and t from 0 to 1.
        link: the whole state of the view, as in a link of the page; set it to restore a state.
    """

    _esm = widget_module()
    data = traitlets.Dict().tag(sync=True)
    latent = traitlets.List(traitlets.Float()).tag(sync=True)
    colour = traitlets.Dict().tag(sync=True)
    link = traitlets.Unicode("").tag(sync=True)

    def __init__(self, model: Manifold, surfaces: Sequence[Path | str] = ()) -> None:
        """Tabulate the materials of a map, in seconds; surfaces are folders that `manifold surface` wrote."""
        self.model = model
        start = model.X[np.argmin(np.linalg.norm(model.X - model.X.mean(axis=0), axis=1))]  # as the page does
        read = [read_surface(path) for path in surfaces]
        super().__init__(data=to_document(model, tabulate(model), read), latent=start.tolist())

    @traitlets.validate("latent")
    def _check_latent(self, proposal: Any) -> list[float]:
        latent: list[float] = self.model.place(proposal["value"]).latent.tolist()
        return latent

    def prediction(self) -> PredictedBRDF:
        """Return the material at the point, in the given colour.

        Raises:
            UsageError: the view shows a prediction that leaves out a material, which only the view can compute.
        """
        if "without" in parse_qs(self.link):
            raise UsageError(
                "the view shows the prediction of a material from the others; move the point to predict from all "
                "materials"
            )
        x, colour = self.model.place(list(self.latent)).latent, dict(self.colour)
        path = colour.pop("between", None)
        if path is not None and np.allclose(x, self.model.between(*path)):  # else the point was moved since
            return self.model.interpolate(*path)
        rows = colour.pop("spectrum", None)
        if rows is not None:
            nm, values = zip(*rows, strict=True)
            colour["reflectance"] = ReflectanceSpectrum(nm, values)
        return self.model.predict(x, self.model.choose_colour(x, ColourChoice(**colour)).colours)
