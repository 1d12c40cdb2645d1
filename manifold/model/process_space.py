"""Base class of latent spaces of Gaussian processes."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from manifold.mapping import mapping_named
from manifold.model.combination import Combination
from manifold.model.decoding import decoder_at
from manifold.model.latent_space import LatentSpace, LeftOutSearch
from manifold.models.decoder import Decoder
from manifold.models.encoder import Encoder
from manifold.records import Array

if TYPE_CHECKING:
    from manifold.model.material_table import MaterialTable
    from manifold.model.materials import MaterialCache
    from manifold.model.settings import Settings


class ProcessSpace(LatentSpace):
    """Latents that a Gaussian process predicts from, one or several per material."""

    @abstractmethod
    def without(self, material: int) -> ProcessSpace:
        """The same latents less those of one material."""

    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """A search that encodes each material in the process on the others."""
        pairs, mapping = self.embedding_pairs(materials.is_isotropic), mapping_named(settings.mapping)
        whole = decoder_at(pairs, self, materials, settings)
        brdfs = materials.filled()

        def find(i: int) -> tuple[Array, Combination]:
            others = np.delete(np.arange(len(self.X)), i)
            rows, rest = self.sample_rows(others), self.without(i)
            decoder = Decoder(rest.gp, whole.mapped[rows], whole.mapping, whole.cosines)
            group = len(rows) // len(others)
            encoder = Encoder.of_decoder(decoder, self.X.shape[1], group, settings.prior, settings.criterion)
            found = rest.embed(encoder, brdfs[i].eval(pairs.wi, pairs.wo).T)
            part = rest.weights(found.latent, found.colours)
            every = np.zeros((*part.shape[:-1], len(whole.mapped)))
            every[..., rows] = part
            return found.latent, Combination(mapping, every, self.sample_bands)

        return find
