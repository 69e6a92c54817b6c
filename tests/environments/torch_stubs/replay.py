"""Run exported drives on recorded motions, with torch and stubs of the frameworks.

    python replay.py CASE.json ...

A case names a file, the framework, an .npz of motions and resets, and an .npz to write.
"""

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
from isaaclab.sim import SimulationContext
from isaaclab.utils.types import ArticulationActions
from mjlab.actuator import ActuatorCmd


def actuators(file, framework, names, environments, step, device):
    """Each actuator of a file, and the columns of its joints."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    own = module.ACTUATORS
    for cfg in own if framework == "mjlab" else own.values():
        patterns = cfg.target_names_expr if framework == "mjlab" else cfg.joint_names_expr
        columns = [
            i for i, name in enumerate(names) if any(re.fullmatch(p, name) for p in patterns)
        ]
        labels = [names[i] for i in columns]
        if framework == "mjlab":
            actuator = cfg.build(None, columns, labels)
            model = SimpleNamespace(opt=SimpleNamespace(timestep=step))
            actuator.initialize(model, None, SimpleNamespace(nworld=environments), device)
        else:
            SimulationContext.physics_dt = step
            actuator = cfg.class_type(cfg, joint_names=labels, joint_ids=columns,
                                      num_envs=environments, device=device)  # fmt: skip
        yield actuator, columns


def force_of(actuator, framework, signals):
    """What an actuator gives in one physics step."""
    position, velocity, setpoint, setpoint_velocity, effort = signals
    if framework == "mjlab":
        return actuator.compute(
            ActuatorCmd(setpoint, setpoint_velocity, effort, position, velocity)
        )
    action = ArticulationActions(setpoint, setpoint_velocity, effort)
    action = actuator.compute(action, joint_pos=position, joint_vel=velocity)
    assert action.joint_positions is None and action.joint_efforts is actuator.applied_effort
    return action.joint_efforts


def demand_full_precision(drive):
    """Drives are refused where all that torch makes has half precision."""
    own = torch.get_default_dtype()
    torch.set_default_dtype(torch.bfloat16)
    try:
        module = sys.modules[type(drive).__module__]
        type(drive)(module.DriveParameters(), 1e-3, 1, 1, "cpu")
    except ValueError as error:
        assert "needs float32 or float64" in str(error)
    else:
        raise AssertionError("half precision was taken")
    finally:
        torch.set_default_dtype(own)


def run(case):
    framework = case["framework"]
    torch.set_default_dtype(getattr(torch, case["dtype"]))
    given = np.load(case["motions"])
    keys = ("position", "velocity", "setpoint", "setpoint_velocity", "effort")
    signals = torch.stack([torch.tensor(given[key]).to(torch.get_default_dtype()) for key in keys])
    steps, environments = signals.shape[1:3]
    own = list(actuators(Path(case["file"]), framework, case["names"], environments,
                         case["physics_step"], "cpu"))  # fmt: skip
    demand_full_precision(own[0][0]._drive)
    resets = {int(step): ids for step, ids in case["resets"]}
    found = np.zeros(signals.shape[1:])
    drawn = {}
    for step in range(steps):
        if step in resets:  # outside inference mode, as frameworks do
            for actuator, _ in own:
                actuator.reset(torch.tensor(resets[step]))
                actuator.reset([])  # of none
        with torch.inference_mode():
            for actuator, columns in own:
                force = force_of(actuator, framework, signals[:, step][..., columns])
                found[step][:, columns] = force.numpy()
        if step in {0, *resets}:
            drawn |= {
                f"{step}:{name}": value.expand(environments, -1)[:, :1].numpy().copy()
                for name, value in own[0][0]._drive._values.items()
            }
    alone = all(
        bool((actuator._drive._values[name][:, :1] == value).all())
        for actuator, _ in own
        for name, value in own[0][0]._drive._values.items()
        if name in case["shared"]
    )
    np.savez(case["out"], force=found, shared=alone, **drawn)


for path in sys.argv[1:]:
    run(json.loads(Path(path).read_text()))
