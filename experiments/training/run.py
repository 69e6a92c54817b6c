"""What a policy that never saw the drive does behind it: PPO with and without the drive.

    make training

Trains Playground's CartpoleBalance with Brax's PPO, bare and behind drives whose delays are drawn
anew at every reset, and plays what came out behind drives of every delay.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import os
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from brax.training.agents.ppo import networks, train
from mujoco_playground import registry, wrapper

import jaxact

# Brax 0.14.2 still calls what JAX 0.12 has no more.
jax.device_put_replicated = lambda tree, devices: jax.tree.map(
    lambda leaf: jnp.stack([leaf] * len(devices)), tree
)

ENVIRONMENT = "CartpoleBalance"
DRIVE: dict[str, Any] = {"actuator": "starleth", "delay": (0.0, 0.12)}
TRAINED = {"bare": None, "behind the drive": DRIVE}
EDGES = np.linspace(0.0, 0.12, 7)  # of the bins of delays [s]
EPISODE, EPISODES = 200, 384
PPO = {
    "num_timesteps": 4_000_000, "num_envs": 256, "episode_length": EPISODE, "unroll_length": 20,
    "batch_size": 32, "num_minibatches": 8, "num_updates_per_batch": 8, "learning_rate": 3e-4,
    "entropy_cost": 1e-2, "discounting": 0.99, "reward_scaling": 10.0,
    "normalize_observations": True, "run_evals": False, "num_evals": 1, "num_eval_envs": 1,
    "max_devices_per_host": 1,
}  # fmt: skip
NETWORK = functools.partial(
    networks.make_ppo_networks, policy_hidden_layer_sizes=(32, 32),
    value_hidden_layer_sizes=(64, 64),
)  # fmt: skip


def environment(drive: dict[str, Any] | None) -> Any:
    """Playground's, bare or behind drives."""
    bare = registry.load(ENVIRONMENT, config_overrides={"impl": "jax"})
    return bare if drive is None else jaxact.environments.playground(bare, **drive)


def trained(drive: dict[str, Any] | None, seed: int) -> Any:
    """A policy, deterministic."""
    make, parameters, _ = train.train(
        environment=environment(drive), network_factory=NETWORK, seed=seed,
        wrap_env_fn=wrapper.wrap_for_brax_training, **PPO,
    )  # fmt: skip
    return make(parameters, deterministic=True)


def played(policy: Any, drive: dict[str, Any] | None) -> tuple[np.ndarray, np.ndarray]:
    """Returns of episodes, and the delays that their drives had [s]; 200 is the most."""
    env = environment(drive)

    def episode(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        def one(state: Any, _: None) -> tuple[Any, jax.Array]:
            state = env.step(state, policy(state.obs, key)[0])
            return state, state.reward

        state, rewards = jax.lax.scan(one, env.reset(key), None, length=EPISODE)
        if drive is None:
            return rewards.sum(), jnp.zeros(())
        draws = state.data.userdata[1 : 1 + env.drive.draws]
        return rewards.sum(), env.drive.values(draws, env.mjx_model)["delay"]

    keys = jax.random.split(jax.random.PRNGKey(99), EPISODES)
    found = jax.jit(jax.vmap(episode))(keys)
    return np.asarray(found[0]), np.asarray(found[1])


def measured(seeds: int) -> dict[str, Any]:
    """Mean returns of every policy: without a drive, and by the delay behind one."""
    found: dict[str, Any] = {"without": {}, "behind": {}, "seconds": {}}
    for name, drive in TRAINED.items():
        rows, alone, begun = [], [], time.perf_counter()
        for seed in range(seeds):
            policy = trained(drive, seed)
            alone.append(float(played(policy, None)[0].mean()))
            returns, delays = played(policy, DRIVE)
            bins = np.digitize(delays, EDGES[1:-1])
            rows.append([float(returns[bins == i].mean()) for i in range(len(EDGES) - 1)])
            print(name, seed, round(alone[-1]), [round(one) for one in rows[-1]], flush=True)
        found["without"][name], found["behind"][name] = alone, rows
        found["seconds"][name] = time.perf_counter() - begun
    return found


def picture(found: dict[str, Any], path: Path) -> None:
    """Mean return over the delay, a thin line for every seed."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    middle = 5e2 * (EDGES[1:] + EDGES[:-1])
    for name, colour in zip(TRAINED, ("tab:brown", "tab:blue"), strict=True):
        rows = np.array(found["behind"][name])
        axes.plot(middle, rows.T, color=colour, linewidth=0.8, alpha=0.5)
        axes.plot(middle, rows.mean(0), color=colour, marker="o", label=f"trained {name}")
    axes.set(xlabel="command delay [ms]", ylabel="return of an episode", ylim=(0, None))
    axes.set_title(f"{ENVIRONMENT} played behind StarlETH's actuator")
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def table(found: dict[str, Any]) -> str:
    """Mean and range over the seeds."""
    heads = ["no drive", *(f"{1e3 * a:.0f}-{1e3 * b:.0f} ms" for a, b in itertools.pairwise(EDGES))]
    lines = [f"| trained | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for name in TRAINED:
        columns = [found["without"][name], *np.transpose(found["behind"][name]).tolist()]
        cells = [f"{np.mean(one):.0f} ({min(one):.0f}-{max(one):.0f})" for one in columns]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def report(found: dict[str, Any]) -> str:
    """The page beside the picture; what it concludes follows from the numbers."""
    bare, seen = (np.mean(found["behind"][name], axis=0) for name in TRAINED)
    spread = max(float(np.ptp(found["behind"][name], axis=0).max()) for name in TRAINED)
    seeds, alone = len(found["without"]["bare"]), np.mean(found["without"]["bare"])
    gap = float(seen[-1] - bare[-1])
    if abs(gap) <= spread:
        words = "the difference between the two is within what the seed does"
    else:
        words = f"training behind the drive {'gains' if gap > 0 else 'loses'} {abs(gap):.0f} there"
    return (
        f"# {ENVIRONMENT} with and without the drive\n\n"
        f"Made by `make training`, {seeds} seeds each;"
        " what was done is in [experiments/training](../../experiments/training/README.md).\n\n"
        "![Return over the delay](training.png)\n\n"
        f"Mean return of an episode, {EPISODE} at most (smallest and largest of the seeds), without"
        f" a drive and behind StarLETH's actuator with a delay:\n\n{table(found)}\n\n"
        f"The policy that never saw the drive returns {alone:.0f} without it, and"
        f" {bare[0]:.0f} behind the shortest and {bare[-1]:.0f} behind the longest delays. At the"
        f" longest, {words} (the seeds of one training differ by up to {spread:.0f}).\n"
    )


def main() -> None:
    """Train, play, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("results/training"))
    parser.add_argument("--redraw", action="store_true", help="from the numbers that are there")
    options = parser.parse_args()
    file = options.out / "training.json"
    if options.redraw:
        found = json.loads(file.read_text(encoding="utf-8"))
    else:
        found = measured(options.seeds)
        options.out.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    picture(found, options.out / "training.png")
    (options.out / "README.md").write_text(report(found), encoding="utf-8")
    print(table(found))


if __name__ == "__main__":
    main()
