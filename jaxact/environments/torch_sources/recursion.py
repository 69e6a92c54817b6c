"""The drive: everything between setpoint and joint force, of many environments at once.

    tick (each control period T):   sense -> control -> hold
    actuate (each physics step h):  delayed command -> force loop -> limits -> mean force

    u = gain_scale (kp (r - q) + kd (r' - v)) + feedforward
    f'' + 2 zeta wn f' + wn^2 f = wn^2 u(t - delay - output_delay)

The command u is held, so that the force loop and any delay, of whole periods or not, are exact. The
measurement is the state of `measurement_delay` ago, between physics steps by a cubic through
positions and velocities. Times are in seconds, forces in N or N m.
"""

from __future__ import annotations

import math
from typing import Any

import torch

from jaxact.environments.torch_sources.force_loop import followed, free_response, part_rows
from jaxact.environments.torch_sources.parameters import DriveParameters

# What a step gets, in its order.
SIGNALS = ("setpoint", "setpoint_velocity", "effort", "position", "velocity")


class Drive:
    """The drives of some joints of all environments, stepped once per physics step.

    Args:
        parameters: of the drive.
        physics_step: h [s].
        num_envs, num_joints: how many.
        device: of all tensors.

    Raises:
        ValueError: a parameter is not what it may be, the control period is not a multiple of the
            physics step, or torch's default is half precision.
    """

    def __init__(
        self, parameters: DriveParameters, physics_step: float, num_envs: int, num_joints: int,
        device: Any,
    ) -> None:  # fmt: skip
        parameters.check()  # again: a framework may have set one since it was made
        self.period, self.physics_step = 1.0 / parameters.control_rate, physics_step
        ratio = self.period / physics_step
        self.substeps = round(ratio)
        if self.substeps < 1 or abs(ratio - self.substeps) > 1e-6 * ratio:
            raise ValueError(
                f"the drive's control period {self.period:g} s is not a multiple of the physics"
                f" step {physics_step:g} s; let the simulation step faster"
            )
        self._ends = parameters.ends()
        self._differenced = parameters.velocity == "differenced"
        self._generator = torch.Generator().manual_seed(parameters.seed)
        self._varied = [name for name, (low, high) in self._ends.items() if low != high]
        # with one number for all joints, groups of joints draw alike whatever varies of each
        self._drawn = self._varied if parameters.each_joint else list(self._ends)
        self._columns = num_joints if parameters.each_joint else 1
        self._like = torch.zeros(num_envs, num_joints, device=device)
        if self._like.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"a drive needs float32 or float64; torch has {self._like.dtype} set")
        # of what is computed once: float64 where the device has it
        self._exact = torch.float32 if self._like.device.type == "mps" else torch.float64
        low_rank = (num_envs, self._columns)
        self._values = {
            name: torch.full(low_rank, low, device=device, dtype=self._exact)
            for name, (low, _) in self._ends.items()
        }
        self._used = {name for name, ends in self._ends.items() if any(ends)}
        late = self._ends["delay"][1] + self._ends["output_delay"][1]
        self._commands = self._line(late)
        self._measured = torch.stack([self._line(self._ends["measurement_delay"][1])] * 2)
        self._setpoints = torch.stack(
            [self._line(self._ends["setpoint_delay"][1] + self.period)] * 3
        )
        self._state = {name: self._like.clone() for name in (
            "older", "newer", "force", "rate", "applied", "position", "velocity", "late_position",
            "late_velocity", "estimated_position", "estimated_velocity", "position_walk",
            "velocity_walk",
        )}  # fmt: skip
        self._environments = torch.arange(num_envs, device=device)
        self._place = torch.zeros_like(self._environments)  # of the physics step in its period
        self._fresh = torch.ones_like(self._environments, dtype=torch.bool)
        self._tables: dict[str, torch.Tensor] = {}
        self.reset()

    def _line(self, longest: float) -> torch.Tensor:
        """A delay line, the newest value first, shape (ticks, environments, joints)."""
        ratio = longest / self.period
        length = math.floor(ratio + 1e-5 * (1.0 + ratio)) + 1
        return self._like.expand(length, *self._like.shape).clone()

    def reset(self, env_ids: Any = None) -> None:
        """Drives that have not begun, with numbers drawn anew.

        At the next step they have held for ever the command that they give then.

        Args:
            env_ids: indices, mask or slice of environments; None for all.
        """
        which = slice(None) if env_ids is None else env_ids
        if isinstance(which, list | tuple):
            none = torch.empty(0, dtype=torch.long)
            which = torch.as_tensor(which if which else none, device=self._like.device)
        # nothing is changed in place: what was made in inference mode could not be, outside it
        mask = torch.zeros_like(self._fresh)
        mask[which] = True
        self._fresh, self._any_fresh = self._fresh | mask, True
        if self._varied:
            shape = (len(self._environments), len(self._drawn), self._columns)
            shares = torch.rand(shape, generator=self._generator, dtype=torch.float64)
            for name in self._varied:
                low, high = self._ends[name]
                share = shares[:, self._drawn.index(name)].to(self._values[name])
                drawn = low + share * (high - low)
                self._values[name] = torch.where(mask.unsqueeze(-1), drawn, self._values[name])
        if self._varied or not self._tables:
            self._prepare(which)

    def _prepare(self, which: Any) -> None:
        """All that follows from the numbers of some environments and stays until their reset."""
        own = {name: value[which] for name, value in self._values.items()}
        h, T = self.physics_step, self.period
        whole, switch = _split(own["delay"] + own["output_delay"], T)
        number, offset = _split(switch, h)
        # time under the older command in each physics step of a period
        older = torch.stack([
            torch.where(number > i, h, torch.where(number == i, offset.clamp(max=h), 0.0))
            for i in range(self.substeps)
        ])  # fmt: skip
        c, s, Ic, Is, rate_g, w = free_response(
            own["wn"], own["zeta"], torch.full_like(own["wn"], h)
        )
        rest_c, rest_s, rest_Ic, _, _, _ = free_response(own["wn"], own["zeta"], h - older)
        square = w * w
        late, remainder = _split(own["measurement_delay"], T)
        instant = T - remainder
        index = (torch.ceil(instant / h - 1e-4) - 1.0).clamp(0.0, self.substeps - 1.0)
        setpoint_late, share = _split(own["setpoint_delay"], T)
        unfiltered = torch.isinf(own["velocity_filter"])
        cutoff = torch.where(unfiltered, 0.0, own["velocity_filter"])
        line = torch.isfinite(own["stall_force"])
        found = {
            "response": torch.stack([c, s, -square * s, rate_g, Ic / h, Is / h]),
            "switching": torch.stack([
                rest_c - c, square * (s - rest_s), (older - Ic + rest_Ic) / h,
            ]),
            "command_at": whole, "measured_at": late, "measuring_step": index,
            "measuring_share": (instant - index * h) / h,
            "setpoint_at": setpoint_late, "setpoint_share": share / T,
            "filter_gain": torch.where(unfiltered, 1.0, -torch.expm1(-cutoff * T)),
            "slope": torch.where(line, own["stall_force"] / own["no_load_speed"], 0.0),
            **own,
        }  # fmt: skip
        if any(math.isfinite(end) for end in self._ends["force_rate_limit"]):
            found["parts"] = torch.cat([
                part_rows(own["wn"], own["zeta"], time) for time in (older, h - older)
            ])  # fmt: skip
        for name, value in found.items():
            value = value.to(torch.long if name.endswith("_at") else self._like.dtype)
            if name in self._tables:  # environments are the last axis but one
                table = self._tables[name].clone()
                table[..., which, :] = value
                value = table
            self._tables[name] = value

    def step(
        self, kp: torch.Tensor, kd: torch.Tensor, limit: torch.Tensor, setpoint: torch.Tensor,
        setpoint_velocity: torch.Tensor, effort: torch.Tensor, position: torch.Tensor,
        velocity: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
        """One physics step, which begins now.

        Args:
            kp, kd: gains [N m/rad, N m s/rad; of slides N/m, N s/m], (environments, joints).
            limit: of the force [N m or N], in either direction.
            setpoint, setpoint_velocity, effort: what the policy asks for.
            position, velocity: of the joints now.

        Returns:
            The mean force over the step, and what it would be without limits.

        Raises:
            ValueError: a signal is not of these environments and joints.
        """
        self._check_shapes((setpoint, setpoint_velocity, effort, position, velocity))
        known, state = self._tables, self._state
        self._measure(position, velocity)
        kp, kd = known["gain_scale"] * kp, known["gain_scale"] * kd
        accepted = _within(setpoint, known["lowest_setpoint"], known["highest_setpoint"])
        target = torch.stack([accepted, setpoint_velocity, effort])
        low, high = self._bounds(limit, velocity)
        if self._any_fresh:
            self._begin(kp, kd, target, position, velocity, (low, high))
        new = (self._place == 0).unsqueeze(-1)
        self._tick(new, kp, kd, target, position, velocity)
        e, d = state["force"] - state["newer"], state["older"] - state["newer"]
        g = state["rate"]
        force_e, force_g, rate_e, rate_g, mean_e, mean_g = known["response"]
        force_d, rate_d, mean_d = known["switching"][:, self._place, self._environments]
        free = state["newer"] + mean_e * e + mean_g * g + mean_d * d
        # Of an ideal actuator each command is limited, and not their mean.
        older, newer = (_within(state[name], low, high) for name in ("older", "newer"))
        ideal = newer + mean_d * (older - newer)
        mean = self._limited(torch.where(torch.isinf(known["wn"]), ideal, free), low, high)
        state["force"] = state["newer"] + force_e * e + force_g * g + force_d * d
        state["rate"] = rate_e * e + rate_g * g + rate_d * d
        self._place = torch.remainder(self._place + 1, self.substeps)
        state["position"], state["velocity"] = position.clone(), velocity.clone()
        return mean, free

    def _check_shapes(self, signals: tuple[torch.Tensor, ...]) -> None:
        """Raise ValueError for a signal that would be broadcast, or be of other joints."""
        for name, value in zip(SIGNALS, signals, strict=True):
            if value.shape != self._like.shape:
                raise ValueError(
                    f"{name} has shape {tuple(value.shape)}; that of this drive is"
                    f" {tuple(self._like.shape)}, environments and joints"
                )

    def _bounds(
        self, limit: torch.Tensor, velocity: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Smallest and largest force: its limit, its range and the force-speed line."""
        known = self._tables
        limit, stall = torch.minimum(limit, known["force_limit"]), known["stall_force"]
        low = torch.maximum(-stall - known["slope"] * velocity, -limit).clamp(max=0.0)
        high = torch.minimum(stall - known["slope"] * velocity, limit).clamp(min=0.0)
        lowest, highest = known["lowest_force"], known["highest_force"]
        return _within(low, lowest, highest), _within(high, lowest, highest)

    def _limited(self, force: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
        """The mean force within its bounds and the rate limit."""
        known = self._tables
        mean = torch.minimum(torch.maximum(force, low), high)
        if "parts" in known:
            parts = known["parts"][:, self._place, self._environments]
            mean, self._state["applied"] = followed(
                parts, self._state, known["force_rate_limit"], mean, low, high
            )
        return mean

    def _measure(self, position: torch.Tensor, velocity: torch.Tensor) -> None:
        """The state at the measuring instant, where it was in the physics step that ends now."""
        if "measurement_delay" not in self._used:
            return
        state, s, h = self._state, self._tables["measuring_share"], self.physics_step
        q0, v0 = state["position"], state["velocity"]
        rise = s * s * (3.0 - 2.0 * s)
        bend = h * s * (1.0 - s) * ((1.0 - s) * v0 - s * velocity)
        before = torch.remainder(self._place - 1, self.substeps).unsqueeze(-1)
        here = self._tables["measuring_step"] == before
        there = q0 + rise * (position - q0) + bend, v0 + s * (velocity - v0)
        for name, value in zip(("late_position", "late_velocity"), there, strict=True):
            state[name] = torch.where(here, value, state[name])

    def _begin(
        self, kp: torch.Tensor, kd: torch.Tensor, target: torch.Tensor, position: torch.Tensor,
        velocity: torch.Tensor, bounds: tuple[torch.Tensor, torch.Tensor],
    ) -> None:  # fmt: skip
        """Drives that have held their first command for ever, where they have not begun.

        Until then they have seen the joints come at the constant velocity that these have now.
        """
        fresh, state, known = self._fresh.unsqueeze(-1), self._state, self._tables
        command = self._controlled(kp, kd, target, position, velocity)
        zero = torch.zeros_like(position)
        delay = known["measurement_delay"]
        before = position - velocity * (self.period + delay)
        before = _counts(before + known["position_bias"], known["position_resolution"])
        begun = dict.fromkeys(("older", "newer", "force"), command)
        begun |= {"applied": torch.minimum(torch.maximum(command, bounds[0]), bounds[1])}
        # Its first tick pushes the latest measurement: what is in the line is one period older.
        line = torch.arange(self._measured.shape[1] + 1, device=position.device).view(-1, 1, 1)
        age = delay + (line - known["measured_at"]).to(delay) * self.period
        late = position - velocity * age
        begun |= {"position": position, "late_position": late[0]}
        begun |= dict.fromkeys(("velocity", "late_velocity", "estimated_velocity"), velocity)
        begun |= {"estimated_position": before}
        for name, value in state.items():
            state[name] = torch.where(fresh, begun.get(name, zero), value)
        self._commands = torch.where(fresh, command, self._commands)
        late = torch.stack([late[1:], velocity.expand_as(late[1:])])
        self._measured = torch.where(fresh, late, self._measured)
        self._setpoints = torch.where(fresh, target.unsqueeze(1), self._setpoints)
        self._place = torch.where(self._fresh, 0, self._place)
        self._fresh, self._any_fresh = torch.zeros_like(self._fresh), False

    def _controlled(
        self, kp: torch.Tensor, kd: torch.Tensor, target: torch.Tensor, position: torch.Tensor,
        velocity: torch.Tensor,
    ) -> torch.Tensor:  # fmt: skip
        """The controller's command, before it is rounded."""
        force = target[2] + self._tables["feedforward"]
        return kp * (target[0] - position) + kd * (target[1] - velocity) + force

    def _tick(
        self, new: torch.Tensor, kp: torch.Tensor, kd: torch.Tensor, target: torch.Tensor,
        position: torch.Tensor, velocity: torch.Tensor,
    ) -> None:  # fmt: skip
        """Sense and control, in the environments whose control period begins."""
        known, state = self._tables, self._state
        if "measurement_delay" in self._used:
            late = torch.stack([state["late_position"], state["late_velocity"]])
            self._measured = _pushed(self._measured, late, new)
            for name, value in (("late_position", position), ("late_velocity", velocity)):
                state[name] = torch.where(new, value, state[name])
            position, velocity = (_read(line, known["measured_at"]) for line in self._measured)
        if "setpoint_delay" in self._used:
            self._setpoints = _pushed(self._setpoints, target, new)
            at, share = known["setpoint_at"], known["setpoint_share"]
            target = torch.stack([
                (1.0 - share) * _read(line, at) + share * _read(line, at + 1)
                for line in self._setpoints
            ])  # fmt: skip
        position, velocity = self._sense(new, position, velocity)
        command = self._controlled(kp, kd, target, position, velocity)
        command = _counts(command, known["command_resolution"])
        self._commands = _pushed(self._commands, command, new)
        newer = _read(self._commands, known["command_at"])
        state["older"] = torch.where(new, state["newer"], state["older"])
        state["newer"] = torch.where(new, newer, state["newer"])

    def _sense(
        self, new: torch.Tensor, position: torch.Tensor, velocity: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """What the controller sees: bias and its walk, noise, counts, and the velocity estimate."""
        known, state, sensed = self._tables, self._state, []
        for name, value in (("position", position), ("velocity", velocity)):
            value = value + known[f"{name}_bias"]
            if f"{name}_bias_walk" in self._used:
                spread = known[f"{name}_bias_walk"] * math.sqrt(self.period)
                walked = state[f"{name}_walk"] + spread * torch.randn_like(value)
                state[f"{name}_walk"] = torch.where(new, walked, state[f"{name}_walk"])
                value = value + walked
            if f"{name}_noise" in self._used:
                value = value + known[f"{name}_noise"] * torch.randn_like(value)
            sensed.append(value)
        position = _counts(sensed[0], known["position_resolution"])
        if not self._differenced:
            return position, _counts(sensed[1], known["velocity_resolution"])
        difference = (position - state["estimated_position"]) / self.period
        before = state["estimated_velocity"]
        velocity = before + known["filter_gain"] * (difference - before)
        for name, value in (("position", position), ("velocity", velocity)):
            state[f"estimated_{name}"] = torch.where(new, value, state[f"estimated_{name}"])
        return position, velocity


def _split(time: torch.Tensor, unit: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A time as a whole number of units and the remainder [s], but for rounding."""
    ratio = time / unit
    whole = torch.floor(ratio + 64 * torch.finfo(ratio.dtype).eps * (1.0 + ratio))
    return whole, (time - whole * unit).clamp(min=0.0)


def _within(value: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    return torch.minimum(torch.maximum(value, low), high)


def _pushed(line: torch.Tensor, value: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
    """Delay lines (..., ticks, environments, joints) with a newer value in some environments."""
    shifted = torch.cat([value.unsqueeze(-3), line[..., :-1, :, :]], dim=-3)
    return torch.where(new, shifted, line)


def _read(line: torch.Tensor, age: torch.Tensor) -> torch.Tensor:
    """The value that was pushed so many ticks before the newest one."""
    return line.gather(0, age.expand(line.shape[1:]).unsqueeze(0))[0]


def _counts(value: torch.Tensor, resolution: torch.Tensor) -> torch.Tensor:
    """The nearest multiple of a resolution, the value itself where that is 0."""
    count = torch.where(resolution > 0.0, resolution, 1.0)
    return torch.where(resolution > 0.0, torch.round(value * (1.0 / count)) * count, value)
