"""What changed between two sessions of one robot: nothing, a part, one of several parts, or something unexplained.

    found = changes(model, data)        # .verdict, .sets, .findings, .slip
    updated = update(model, data, found.sets[0].hypotheses)

The old model predicts the readings of the new session up to its own uncertainty: residuals are whitened by the noise
and the posterior of the old fit together, the measuring frame is a nuisance, and the parts of the robot are the
hypotheses. The tests are those of a diagnosis (`pcalib.diagnosis.screen`, `pcalib.diagnosis.adequacy`).
"""
