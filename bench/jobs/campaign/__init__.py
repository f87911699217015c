"""Campaigns: many virtual robots, each measured, identified, compensated and checked in MuJoCo.

    spec.py      the TOML file and all it names        → Campaign
    sweep.py     its sweeps                            → cells, each a plain table
    settings.py  one table                             → Settings, checked
    trial.py     one robot of one cell                 → rows; a pure function
    store.py     rows                                  → parts, written whole; results.parquet
    workers.py   where trials run: processes here, or an existing dask cluster
    run.py       all of it: resume, progress, interruption

Results depend on the spec, its seed and the versions of the packages, and on nothing else: not on the number of
workers, the order in which they finish, or how often the campaign was killed on the way.
"""
