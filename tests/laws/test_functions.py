"""What laws may depend on: nothing that only noise makes vary."""

from bench.jobs.diagnosis_benchmark import rows
from pcalib.diagnosis.problem import problem
from pcalib.laws import functions
from pcalib.laws.search import propose


def test_the_height_of_a_bed_is_no_variable():
    """A probe touches a level bed: the heights at which the model puts the tool are all alike but for the residuals, so
    that a law by the height would explain every residual by itself."""
    made = rows.replay("noise.bed_contacts_checked/0#0", 5)
    asked = problem(made.model, made.data)
    names = [v.name for v in functions.variables(asked.point.situation)]
    assert "z" not in names and "x" in names and "y" in names
    assert not propose(asked).families
