"""What the drive costs in environments of MuJoCo Playground: a quadruped and a humanoid."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from benchmarks.timing import Row, alternate

ENVIRONMENTS = 64
DRIVE: dict[str, Any] = {"actuator": "starleth", "delay": (0.002, 0.008)}


def rows(quick: bool) -> Iterator[Row]:
    """The lines of the table; none where Playground is not installed."""
    try:
        from mujoco_playground._src import registry
    except ModuleNotFoundError:
        print("no MuJoCo Playground (jaxact[playground]): its environments are left out")
        return
    steps, repeats = (2, 1) if quick else (20, 9)
    humanoid = registry.load("HumanoidStand", config_overrides={"impl": "jax"})
    for name, env in (("Go1, 12 joints", go1()), ("humanoid, 21 joints", humanoid)):
        for work in ("the same without", "the same without, all iterations of the solver in both"):
            yield Row(
                f"{ENVIRONMENTS} environments of Playground with drives ({name})",
                work,
                *alternate(stepped(driven(env), steps), stepped(env, steps), repeats),
                "environment step",
                "at least 0.95 (5 % more)",
                1 / 1.05,
            )
            _same_work(env)


def _same_work(env: Any) -> None:
    """Let the solver do all its iterations: with drives the motion is another, and needs others."""
    options = env.mjx_model.opt
    never = {f"opt.{name}": 0.0 * getattr(options, name) for name in ("tolerance", "ls_tolerance")}
    env._mjx_model = env.mjx_model.tree_replace(never)


def driven(env: Any) -> Any:
    """The environment with drives whose delays are drawn at every reset."""
    import jaxact

    return jaxact.environments.playground(env, **DRIVE)


def go1() -> Any:
    """Playground's Go1 on flat ground, without its meshes, which no wheel has."""
    from ml_collections import config_dict
    from mujoco import mjx
    from mujoco_playground._src import mjx_env

    folder = Path(mjx_env.__file__).parent / "locomotion" / "go1" / "xmls"
    spec = mujoco.MjSpec.from_file(str(folder / "scene_mjx_feetonly_flat_terrain.xml"))
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for part in (*spec.meshes, *spec.materials, *spec.textures):
        spec.delete(part)
    for geom in spec.geoms:
        geom.material = ""

    class Go1(mjx_env.MjxEnv):
        """It stands; the observation is its posture."""

        xml_path = ""
        action_size = property(lambda self: self._mj_model.nu)
        mj_model = property(lambda self: self._mj_model)
        mjx_model = property(lambda self: self._mjx_model)

        def __init__(self) -> None:
            super().__init__(config_dict.create(ctrl_dt=0.02, sim_dt=0.004))
            self._mj_model = spec.compile()
            self._mj_model.opt.timestep = self.sim_dt
            self._mjx_model = mjx.put_model(self._mj_model, impl="jax")

        def reset(self, rng: jax.Array) -> Any:
            start = jnp.asarray(self._mj_model.keyframe("home").qpos)
            data = mjx_env.make_data(self._mj_model, qpos=start, impl="jax")
            zero = jnp.zeros(())
            return mjx_env.State(data, data.qpos, zero, zero, {}, {"rng": rng})

        def step(self, state: Any, action: jax.Array) -> Any:
            control = jnp.asarray(self._mj_model.keyframe("home").ctrl) + 0.1 * action
            data = mjx_env.step(self._mjx_model, state.data, control, self.n_substeps)
            return state.replace(data=data, obs=data.qpos)

    return Go1()


def stepped(env: Any, steps: int) -> Callable[[], float]:
    """Environment steps under a fixed action; how many of all environments."""
    keys = jax.random.split(jax.random.PRNGKey(0), ENVIRONMENTS)
    state = jax.jit(jax.vmap(env.reset))(keys)
    action = 0.1 * jnp.ones((ENVIRONMENTS, env.action_size))

    @jax.jit
    def run(state: Any) -> Any:
        return jax.lax.scan(
            lambda s, _: (jax.vmap(env.step)(s, action), None), state, None, length=steps
        )[0]

    def work() -> float:
        jax.block_until_ready(run(state))
        return steps

    return work
