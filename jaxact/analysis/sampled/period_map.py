"""The loop as the computer sees it: a linear map over one control period T.

At tick k the controller reads the joint and holds u_k until the next tick; the command reaches the
force servo `delay` = (d + fraction) T later, so that within one period the servo sees first
u_{k-d-1}, then u_{k-d}:

    x_{k+1} = Phi x_k + Gamma_old u_{k-d-1} + Gamma_new u_{k-d},    x = (q, v, f, f'/wn)
    u_k = -(kp q_k + kd w_k)

with w_k the velocity itself (`sampled`) or the difference of positions through a first-order
filter (`differenced`): w_k = b w_{k-1} + (1 - b) (q_k - q_{k-1}) / T, b = exp(-velocity_filter T).
Closing the loop over the held commands gives one matrix; its spectral radius decides stability
(Astrom and Wittenmark, Computer-Controlled Systems, sampling of systems with delay).
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.sampled.servo import held_transition, sprung_transition

POSITION, VELOCITY, FORCE, FORCE_RATE = range(4)
_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SampledLoop:
    """One joint under sampled control, or a batch of them: fields broadcast against each other.

    Attributes:
        kp: stiffness [N/m].
        kd: damping [N s/m].
        mass: m [kg], > 0.
        natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal.
        damping_ratio: zeta of the force servo [-], > 0.
        delay: sum of command, measurement and output delay [s], >= 0; only the sum matters here.
        control_period: T [s], > 0.
        velocity_filter: cutoff of the filter of the differenced velocity [rad/s], > 0, inf = none.
        velocity: "sampled" or "differenced".
        integrator: "exact", or "euler" for MuJoCo's semi-implicit Euler, v += h F/m, q += h v, with
            F the mean force over the substep.
        substeps: physics steps in a control period, n = T/h; only read by "euler".
        joint_damping, joint_stiffness: of the joint itself, c [N s/m] and k [N/m]; None: none of
            the batch has one, and nothing is computed for it.
    """

    kp: jax.Array
    kd: jax.Array
    mass: jax.Array
    natural_frequency: jax.Array
    damping_ratio: jax.Array
    delay: jax.Array
    control_period: jax.Array
    velocity_filter: jax.Array = field(default=float("inf"))  # type: ignore[assignment]
    velocity: str = field(default="sampled", metadata=_STATIC)
    integrator: str = field(default="exact", metadata=_STATIC)
    substeps: int = field(default=1, metadata=_STATIC)
    joint_damping: jax.Array | None = None
    joint_stiffness: jax.Array | None = None

    @property
    def sprung(self) -> bool:
        """Whether some joint of the batch has a damping or stiffness of its own; static."""
        return self.joint_damping is not None or self.joint_stiffness is not None

    @property
    def joint(self) -> tuple[jax.Array | float, jax.Array | float] | None:
        """Damping and stiffness of the joint, None where it is sprung nowhere; static."""
        if not self.sprung:
            return None
        pair = self.joint_damping, self.joint_stiffness
        return (0.0 if pair[0] is None else pair[0]), (0.0 if pair[1] is None else pair[1])


def delay_steps(delay: np.ndarray, control_period: np.ndarray | float) -> int:
    """The whole control periods in the longest of some delays, for what has a fixed size by it.

    Args:
        delay: [s], any shape.
        control_period: T [s], broadcastable.
    """
    return int(np.floor(np.asarray(delay) / control_period + 1e-9).max())


def period_map(loop: SampledLoop) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Phi (4, 4), Gamma_old (4,), Gamma_new (4,) and the whole steps of delay d, of one loop.

    x_{k+1} = Phi x_k + Gamma_old u_{k-d-1} + Gamma_new u_{k-d}, x = (q [m], v [m/s], f [N],
    f'/wn [N]). Exact for every real delay; d is a float so that it can be traced.

    Args:
        loop: fields scalar.
    """
    period = loop.control_period
    steps = jax.lax.stop_gradient(jnp.floor(loop.delay / period))
    remainder = loop.delay - steps * period
    # Whole periods of delay but for rounding are no less, and have a derivative.
    remainder = _part(remainder - jax.lax.stop_gradient(jnp.minimum(remainder, 0.0)), period)
    servo = (loop.mass, loop.natural_frequency, loop.damping_ratio)
    if loop.integrator == "exact":
        times = jnp.stack([period, remainder, period - remainder])
        (phi, _, late), (_, early, newer) = _transitions(times, servo, loop.joint)
        return phi, small_product(late, early), newer, steps
    if loop.integrator != "euler":
        raise ValueError(f'integrator is "exact" or "euler", not {loop.integrator!r}')
    phi, older, newer = _euler_period(remainder, period, loop.substeps, servo, loop.joint)
    return phi, older, newer, steps


def newer_command(
    loop: SampledLoop, remainder: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Phi (4, 4) after a part of a period, Gamma_new (4,) there, and its derivative by the part.

    Args:
        loop: fields scalar; its delay is not used.
        remainder: part of the control period that the older command acts for [s], scalar. Where it
            is 0 Phi is that of the period, and Gamma_new what a command does in all of it.
    """
    servo = (loop.mass, loop.natural_frequency, loop.damping_ratio)
    if loop.integrator == "exact":
        left = (loop.control_period - remainder)[None]
        phi, newer = (each[0] for each in _transitions(left, servo, loop.joint))
        ideal = jnp.isinf(loop.natural_frequency)
        wn = jnp.where(ideal, 1.0, loop.natural_frequency)
        # Under a command of 1 the rate of an ideal force is the acceleration, else f'/wn grows.
        return phi, newer, -jnp.where(ideal, phi[:, VELOCITY] / loop.mass, wn * phi[:, FORCE_RATE])

    def euler(remainder: jax.Array) -> tuple[jax.Array, jax.Array]:
        phi, _, newer = _euler_period(
            remainder, loop.control_period, loop.substeps, servo, loop.joint
        )
        return newer, phi

    newer, slope, phi = jax.jvp(euler, (remainder,), (jnp.ones_like(remainder),), has_aux=True)
    return phi, newer, slope


def small_product(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Their product, as a sum: of a batch of so small ones it takes a fraction of a dot's time."""
    return jnp.sum(matrix * vector[None], axis=1)


def _part(time: jax.Array, whole: jax.Array) -> jax.Array:
    """`time` limited to [0, whole], with the derivative from the right at the limits."""
    return jnp.where(time >= whole, whole, jnp.where(time >= 0.0, time, 0.0))


Joint = tuple[jax.Array | float, jax.Array | float] | None


def _transitions(
    times: jax.Array, servo: tuple[jax.Array, jax.Array, jax.Array], joint: Joint
) -> tuple[jax.Array, jax.Array]:
    """Phi (n, 4, 4) and Gamma (n, 4) for several times at once."""
    if joint is not None:
        return jax.vmap(lambda time: sprung_transition(time, *servo, *joint))(times)
    return jax.vmap(held_transition, in_axes=(0, None, None, None))(times, *servo)


def _euler_period(
    remainder: jax.Array,
    period: jax.Array,
    substeps: int,
    servo: tuple[jax.Array, jax.Array, jax.Array],
    joint: Joint,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Phi, Gamma_old, Gamma_new of n steps of v += h F/m, q += h v with the mean force F.

    The servo is exact and the impulse h F/m is its own change of velocity; only the position
    differs from the exact motion. MuJoCo takes the damping of a joint at the end of the step, and
    its spring at the beginning: (m + h c) v' = m v + h (F - k q).
    """
    h = period / substeps
    older = _part(remainder - h * jnp.arange(substeps, dtype=h.dtype), h)
    phi, gamma = _transitions(jnp.concatenate([older, h - older]), servo, None)
    total = jnp.eye(6, dtype=phi.dtype)
    for i in range(substeps):
        early, late = phi[i], phi[substeps + i]
        step = jnp.eye(6, dtype=phi.dtype).at[:4, :4].set(late @ early)
        step = step.at[:4, 4].set(late @ gamma[i]).at[:4, 5].set(gamma[substeps + i])
        if joint is not None:
            moved = step[VELOCITY].at[POSITION].add(-h * joint[1] / servo[0])
            step = step.at[VELOCITY].set(moved / (1.0 + h * joint[0] / servo[0]))
        step = step.at[POSITION].set((h * step[VELOCITY]).at[POSITION].add(1.0))
        total = step @ total
    return total[:4, :4], total[:4, 4], total[:4, 5]


def one_period_matrix(loop: SampledLoop, max_delay_steps: int) -> jax.Array:
    """The closed loop over one control period, as a matrix of one loop.

    State: (q, v, f, f'/wn, u_{k-1}, ..., u_{k-D-1}) with D = max_delay_steps, and for the
    differenced velocity also (q_{k-1}, w_{k-1}). A delay that does not fit gives NaN.

    Args:
        loop: fields scalar.
        max_delay_steps: largest whole number of periods in any delay; fixes the matrix's size.
    """
    phi, older, newer, steps = period_map(loop)
    differenced = _is_differenced(loop)
    held = max_delay_steps + 1
    size = 4 + held + 2 * differenced
    identity = jnp.eye(size, dtype=phi.dtype)
    estimate = identity[VELOCITY]
    if differenced:
        pole = filter_pole(loop)
        difference = (identity[POSITION] - identity[size - 2]) / loop.control_period
        estimate = pole * identity[size - 1] + (1.0 - pole) * difference
    command = -(loop.kp * identity[POSITION] + loop.kd * estimate)

    # Row i of `commands` is u_{k-i} as a function of the state.
    commands = jnp.concatenate([command[None], identity[4 : 4 + held]])
    index = jnp.arange(held + 1)
    commands_old = (index == steps + 1).astype(phi.dtype) @ commands
    commands_new = (index == steps).astype(phi.dtype) @ commands
    joint = phi @ identity[:4] + jnp.outer(older, commands_old) + jnp.outer(newer, commands_new)
    rows = [joint, commands[:held]]
    if differenced:
        rows.append(jnp.stack([identity[POSITION], estimate]))
    return jnp.where(steps <= max_delay_steps, jnp.concatenate(rows), jnp.nan)


def filter_pole(loop: SampledLoop) -> jax.Array:
    """b = exp(-velocity_filter T) [-], 0 without a filter."""
    unfiltered = jnp.isinf(loop.velocity_filter)
    cutoff = jnp.where(unfiltered, 1.0, loop.velocity_filter)
    return jnp.where(unfiltered, 0.0, jnp.exp(-cutoff * loop.control_period))


def _is_differenced(loop: SampledLoop) -> bool:
    if loop.velocity not in ("sampled", "differenced"):
        raise ValueError(f'velocity is "sampled" or "differenced", not {loop.velocity!r}')
    return loop.velocity == "differenced"
