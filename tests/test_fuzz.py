"""A sample of the attempts of tests/fuzz.py: right each."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz import GROUPS, SEED, outcome

SAMPLES = {"keys": 150, "--set": 60, "command line": 40, "toml": 40, "csv": 40, "msh": 40}


@pytest.mark.parametrize("name", GROUPS)
def test_a_sample_of_what_is_wrong(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    attempts = list(islice(GROUPS[name](), 10_000))
    chosen = np.random.default_rng(SEED).permutation(len(attempts))[: SAMPLES[name]]
    wrong = {label: found for label, attempt in (attempts[i] for i in chosen) if (found := outcome(attempt)) != "right"}
    assert wrong == {}
