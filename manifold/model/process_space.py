"""Base class of latent spaces of Gaussian processes."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from manifold.latent.decoder import Decoder
from manifold.latent.encoder import Encoder
from manifold.model.combination import Combination
from manifold.model.decoding import decoder_at
from manifold.model.latent_space import LatentSpace, LeftOutSearch
from manifold.model.material_table import MaterialTable
from manifold.model.materials import MaterialCache
from manifold.model.settings import Settings
from manifold.records import Array


class ProcessSpace(LatentSpace):
    """Latents that a Gaussian process predicts from, one or several per material."""

    @abstractmethod
    def without(self, material: int) -> ProcessSpace:
        """The same latents less those of one material."""

    def encoder(self, decoder: Decoder, settings: Settings) -> Encoder:
        """What finds latents by the criterion of the settings."""
        group = len(self.sample_rows(np.arange(1)))
        return Encoder.of_decoder(decoder, self.X.shape[1], group, settings.prior, settings.criterion)

    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """A search that encodes each material in the process on the others."""
        pairs = self.embedding_pairs(materials.is_isotropic)
        whole = decoder_at(pairs, self, materials, settings)
        brdfs = materials.filled()

        def find(i: int) -> tuple[Array, Combination, float]:
            others = np.delete(np.arange(len(self.X)), i)
            rows, rest = self.sample_rows(others), self.without(i)
            decoder = Decoder(rest.gp, whole.mapped[rows], whole.mapping, whole.cosines)
            found = rest.embed(decoder, brdfs[i].eval(pairs.wi, pairs.wo).T, settings)
            part = rest.weights(found.latent, found.colours)
            every = np.zeros((*part.shape[:-1], len(whole.mapped)))
            every[..., rows] = part
            return found.latent, Combination(whole.mapping, every, self.sample_bands), found.residual

        return find
