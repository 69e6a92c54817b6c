"""Gains that are as good as they can be, and certified: objective, descent, polish, certificate.

`run.tune` and `robust.tune_box` do it for a joint, `pareto.front` for a whole front. `objective`,
`optimize`, `polish` and `rescue` know nothing of joints.
"""
