"""Gains that are as good as they can be, and certified; of joints, ensembles and robots alike.

`goal` says what is asked and `box` what is not known; `objective`, `optimise`, `polish` and
`newton` search, knowing nothing of joints; `certificate`, `result` and `report` say what was found.
What truly differs is in folders: `joint` and `robot` (the linear loops, their metrics, and where
the search begins: `search.tune` of each), and `rollouts`, nonlinear ones.
"""
