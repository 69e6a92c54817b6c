"""The study's figures 2, 3 and 4 and its quantitative claims, exact and as simulated.

`study` says which loops, `exact` and `simulated` compute them independently of each other,
`results` gathers the numbers, `pictures` draws them and `claims` holds the study against them.
"""
