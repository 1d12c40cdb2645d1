"""What a user chooses by its name."""

from __future__ import annotations

import pytest

from manifold import registries
from manifold.core.errors import UnknownNameError
from manifold.fit.exports.targets import Target
from manifold.registries import Registry

ALL = [each for each in vars(registries).values() if isinstance(each, Registry)]


def test_an_unknown_name_is_an_error_that_lists_those_there_are():
    few = Registry("kernel", [("se", 1), ("matern52", 2)])
    assert (few["se"], few.get("cubic"), str(few)) == (1, None, "se or matern52")
    with pytest.raises(UnknownNameError, match="no kernel is called 'cubic'; expected one of se, matern52"):
        few["cubic"]


def test_of_many_names_those_like_it_are_listed():
    many = Registry("setting", ((f"pca_{k}", k) for k in range(40)))
    with pytest.raises(UnknownNameError, match=r"no setting is called 'PCA_17x'; did you mean pca_17, "):
        many["PCA_17x"]


@pytest.mark.parametrize("registry", ALL, ids=lambda registry: registry.what)
def test_every_name_stands_for_something(registry):
    assert len(registry) == len(list(registry.values())) > 1


def test_suffixes_in_helps_are_those_of_the_targets():
    for name, target in registries.TARGETS.items():
        assert isinstance(target, Target)
        assert (target.name, target.suffix) == (name, registries.EXPORT_SUFFIXES[name])
    for name, target in registries.CONVERTED.items():
        assert target.suffixes == registries.CONVERTED_SUFFIXES[name]
