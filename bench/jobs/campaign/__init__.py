"""Campaigns: many virtual robots, each measured, identified, compensated and checked in MuJoCo.

    spec.py      the TOML file and all it names                     → Spec
    sweep.py     its sweeps                                         → the swept values of each cell
    cell.py      one combination of swept values                    → Cell, every number of it checked
    trial.py     one robot of one cell                              → rows; a pure function
    study.py     the campaign as a study of `bench.jobs.study`, which runs, resumes and stores it
    summary.py   the results                                        → figures per cell, method and tool
"""
