"""Which physical effect is missing from a model: noise, misfit, patterns, adequacy sets, verdict, next measurement.

    found = diagnose(model, data)      # .verdict, .sets, .findings, .cells, .noise
    plan(problem(model, data), [[resolve(a, model)], [resolve(b, model)]], 6)

See docs/diagnosis.md for the method.
"""
