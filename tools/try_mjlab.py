"""Run an exported drive in mjlab itself: in an environment that has mjlab, not in jaxact's.

    jaxact export MODEL.xml --to mjlab --set kp=30 --set kd=0.5 --set delay=0.0075 --out drive.py
    python tools/try_mjlab.py MODEL.xml drive.py

Simulates four environments with MuJoCo-Warp on the CPU, the setpoint stepping once, and says
whether the torque at the joints follows after the drive's delay and not before, and whether drives
begin anew in the environments that are reset.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import mujoco
import torch
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

ENVIRONMENTS, PHYSICS_STEP, STEP = 4, 0.001, 0.2
RESET, STEPS = 30, 60


def module_of(file: Path) -> Any:
    """The exported file, imported."""
    spec = importlib.util.spec_from_file_location("drive", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["drive"] = module
    spec.loader.exec_module(module)
    return module


def passive(model: Path) -> mujoco.MjSpec:
    """The model without actuators of its own."""
    spec = mujoco.MjSpec.from_file(str(model))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    return spec


def main() -> int:
    """0 if torques follow as the drive says."""
    model, file = Path(sys.argv[1]), Path(sys.argv[2])
    module = module_of(file)
    articulation = EntityArticulationInfoCfg(actuators=module.ACTUATORS)
    robot_cfg = EntityCfg(spec_fn=lambda: passive(model), articulation=articulation)
    scene = Scene(SceneCfg(num_envs=ENVIRONMENTS, entities={"robot": robot_cfg}), device="cpu")
    settings = SimulationCfg(mujoco=MujocoCfg(timestep=PHYSICS_STEP, gravity=(0.0, 0.0, 0.0)))
    simulation = Simulation(ENVIRONMENTS, settings, scene.compile(), "cpu")
    scene.initialize(simulation.mj_model, simulation.model, simulation.data)
    robot = scene["robot"]
    scene.reset()
    torques = []
    for number in range(STEPS):
        if number == RESET:
            robot.reset(torch.tensor([1, 3]))
            held = STEP - robot.data.joint_pos, -robot.data.joint_vel
        target = torch.full_like(robot.data.joint_pos, STEP if number else 0.0)
        robot.set_joint_position_target(target)
        scene.write_data_to_sim()
        torques.append(simulation.data.ctrl.clone())
        simulation.step()
        scene.update(PHYSICS_STEP)
    found = torch.stack(torques)
    parameters = module.ACTUATORS[0].drive
    late = 1 + int((parameters.delay + parameters.output_delay) / PHYSICS_STEP)
    kp, kd = (torch.cat([getattr(one, name) for one in robot.actuators], dim=1)
              for name in ("stiffness", "damping"))  # fmt: skip
    follows = bool(found[:late].abs().max() < 1e-5 and (found[late + 1] > 0.9 * kp * STEP).all())
    # what was reset has held its first command for ever; the others go on as they were
    first = (kp * held[0] + kd * held[1])[[1, 3]]
    anew = torch.allclose(found[RESET, [1, 3]], first, rtol=1e-4)
    anew = anew and torch.equal(found[RESET, 0], found[RESET, 2])
    anew = anew and not torch.allclose(found[RESET, 0], found[RESET, 1], rtol=1e-3)
    print(f"torque stays 0 for {late} steps and follows then: {follows}; begins anew: {anew}")
    return 0 if follows and anew else 1


if __name__ == "__main__":
    sys.exit(main())
