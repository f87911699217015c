"""Every registry finds what its package holds, and says what it does not."""

import pytest

from bench import faults, noises
from bench import kinds as bench_kinds
from pcalib import effects, importers, kinds
from pcalib.errors import EffectError, InputError
from pcalib.registry import Registry

ALL = {each.what + each.package: each for each in (
    kinds.KINDS, bench_kinds.KINDS, effects.LIBRARY, faults.FAULTS, noises.NOISES, importers.IMPORTERS,
)}  # fmt: skip


@pytest.mark.parametrize("registry", ALL.values(), ids=ALL)
def test_every_module_holds_one(registry: Registry):
    assert registry.names() == sorted(registry.names()) and len(registry.names()) > 1
    assert all(registry.get(name) is not None for name in registry.names())
    near = registry.names()[0][:-1]
    with pytest.raises(EffectError if registry is effects.LIBRARY else InputError, match="did you mean"):
        registry.get(near)
