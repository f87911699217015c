"""The peers find what is planted among columns, and nothing among noise as far as they can."""

from dataclasses import replace

import numpy as np
import pytest

from bench.jobs.diagnosis_benchmark.rows import Task, get
from bench.jobs.diagnosis_benchmark.rows import _peers as peers
from pcalib.diagnosis.problem import problem

RNG = np.random.default_rng(3)
X = RNG.standard_normal((300, 2000))
X /= np.linalg.norm(X, axis=0)


@pytest.mark.parametrize("name", peers.NAMING)
def test_planted_columns_are_found_the_largest_first(name):
    y = X[:, [7, 1200]] @ [25.0, -12.0] + RNG.standard_normal(300)
    chosen = peers.NAMING[name](X.astype(np.float32), y)
    assert list(chosen[:2]) == [7, 1200]


def test_what_lies_in_the_geometry_is_no_column():
    task = Task("noise", "white", 0, 1)
    [made] = get("noise").sets(task, task.generator(0))
    asked = problem(made.model, made.data)
    columns = peers.Columns.of(asked)
    assert np.allclose(np.linalg.norm(columns.values, axis=0), 1, atol=1e-3)
    nuisance = asked.nuisance / np.linalg.norm(asked.nuisance, axis=0)
    strong = np.linalg.svd(nuisance, full_matrices=False)[0][:, :30]
    assert np.abs(strong.T @ columns.values).max() < 0.05
    assert len(columns.channel) == len(columns.variables) == columns.values.shape[1] > 3000


def test_a_process_predicts_what_repeats():
    task = Task("held_out", "misfits", 0, 1)
    [made] = get("held_out").sets(task, task.generator(1))
    quiet = peers.process(made.model, made.data, 15e-6)
    shifted = replace(made.data, position=made.data.position + 1e-4)  # by 7 noise units, the same for all rows
    assert 0.7 < quiet < 10 and peers.process(made.model, shifted, 15e-6) < quiet + 2
