"""Sources of the files that `jaxact export --to mjlab` and `--to isaaclab` write, in torch.

`recursion` is the drive; the other modules are the actuators of the frameworks, which are written
below it. Nothing in jaxact imports them: they are read as text.
"""
