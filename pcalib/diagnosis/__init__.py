"""Which physical effect is missing: noise, misfit, patterns, adequacy sets, verdict, limits and the next measurement."""
