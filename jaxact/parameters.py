"""Every numeric parameter of a loop: name, unit, default, bounds and meaning, in one flat table.

The short names are used in specifications, on the command line, in result stores and in pictures;
the long names, with underscores, are accepted there as well. The units are those of a joint that
slides; `jaxact.units` gives those of a rotary one, for whatever is written of it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from jaxact.errors import UserError, nearest, shown
from jaxact.units import turned

INF = math.inf

# The parameters' short names, each written here and nowhere else.
KP = "kp"
KD = "kd"
GAIN_SCALE = "gain_scale"
FEEDFORWARD = "feedforward"
MASS = "mass"
WN = "wn"
ZETA = "zeta"
DELAY = "delay"
SETPOINT_DELAY = "setpoint_delay"
MEASUREMENT_DELAY = "measurement_delay"
OUTPUT_DELAY = "output_delay"
CONTROL_RATE = "control_rate"
POLICY_RATE = "policy_rate"
POSITION_RESOLUTION = "position_resolution"
VELOCITY_RESOLUTION = "velocity_resolution"
COMMAND_RESOLUTION = "command_resolution"
POSITION_NOISE = "position_noise"
VELOCITY_NOISE = "velocity_noise"
POSITION_BIAS = "position_bias"
VELOCITY_BIAS = "velocity_bias"
POSITION_BIAS_WALK = "position_bias_walk"
VELOCITY_BIAS_WALK = "velocity_bias_walk"
VELOCITY_FILTER = "velocity_filter"
FORCE_LIMIT = "force_limit"
FORCE_RATE_LIMIT = "force_rate_limit"
STALL_FORCE = "stall_force"
NO_LOAD_SPEED = "no_load_speed"
SETPOINT = "setpoint"
INITIAL_POSITION = "initial_position"
INITIAL_VELOCITY = "initial_velocity"
REST_AMPLITUDE = "rest_amplitude"
PAYLOAD = "payload"
INERTIA_SCALE = "inertia_scale"
JOINT_DAMPING = "joint_damping"
JOINT_STIFFNESS = "joint_stiffness"
JOINT_ARMATURE = "joint_armature"
JOINT_FRICTION = "joint_friction"
CONTACT_FRICTION = "contact_friction"


@dataclass(frozen=True)
class Parameter:
    """One numeric parameter of a loop.

    Attributes:
        name: short name, the one symbol used everywhere.
        long_name: in words.
        unit: SI unit, "1" for none.
        default: value where nothing is given.
        minimum, maximum: closed bounds of a finite value.
        infinite: infinity is allowed too, and means "none" or "ideal".
        description: one sentence.
    """

    name: str
    long_name: str
    unit: str
    default: float
    minimum: float
    maximum: float
    infinite: bool
    description: str

    @property
    def bounds(self) -> str:
        """The bounds without unit: `0 to 10`."""
        return f"{self.minimum:g} to {self.maximum:g}{', or inf' if self.infinite else ''}"

    @property
    def allowed(self) -> str:
        """The bounds with unit: `0 to 10 [s]`."""
        return self.bounds if self.unit == "1" else f"{self.bounds} [{self.unit}]"

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a coordinate in a result store."""
        return {"units": self.unit, "long_name": self.long_name, "description": self.description}


def _any(
    name: str, long_name: str, unit: str, default: float, limit: float, description: str
) -> Parameter:
    return Parameter(name, long_name, unit, default, -limit, limit, False, description)


def _at_least_zero(
    name: str, long_name: str, unit: str, default: float, limit: float, description: str
) -> Parameter:
    return Parameter(name, long_name, unit, default, 0.0, limit, False, description)


_TABLE = (
    _any(KP, "stiffness", "N/m", 400.0, 1e9, "Proportional gain of the PD controller."),
    _any(KD, "damping", "N s/m", 20.0, 1e9, "Derivative gain of the PD controller."),
    _at_least_zero(
        GAIN_SCALE, "gain scale", "1", 1.0, 1e9, "Factor on both gains, of all joints alike."
    ),
    _any(FEEDFORWARD, "feedforward force", "N", 0.0, 1e9, "Constant force added to the command."),
    Parameter(
        MASS, "moved mass", "kg", 0.7, 1e-9, 1e9, False, "Mass that the joint moves."
    ),
    Parameter(
        WN, "natural frequency", "rad/s", INF, 1e-3, 1e9, True,
        "Natural frequency of the actuator's closed force loop; inf: ideal, no dynamics.",
    ),
    Parameter(
        ZETA, "damping ratio", "1", 1.0, 1e-6, 1e3, False,
        "Damping ratio of the actuator's closed force loop.",
    ),
    _at_least_zero(
        DELAY, "command delay", "s", 0.0, 10.0,
        "Delay from the controller's command to the actuator's dynamics.",
    ),
    _at_least_zero(
        SETPOINT_DELAY, "setpoint delay", "s", 0.0, 10.0,
        "Delay of the setpoint before the controller; linear between its control ticks.",
    ),
    _at_least_zero(
        MEASUREMENT_DELAY, "measurement delay", "s", 0.0, 10.0,
        "Delay of the sensed position and velocity.",
    ),
    _at_least_zero(
        OUTPUT_DELAY, "output delay", "s", 0.0, 10.0,
        "Delay of the force after the actuator's dynamics, before its force-speed line.",
    ),
    Parameter(
        CONTROL_RATE, "control rate", "Hz", 1000.0, 0.1, 1e6, False,
        "Rate at which the controller runs; its output is held in between.",
    ),
    Parameter(
        POLICY_RATE, "policy rate", "Hz", INF, 0.1, 1e6, True,
        "Rate at which setpoints are given, held in between; divides the control rate, and changes"
        " neither stability nor margins; inf: as the control rate.",
    ),
    _at_least_zero(
        POSITION_RESOLUTION, "position resolution", "m", 0.0, 1e6,
        "Size of one count of the position encoder; 0: none.",
    ),
    _at_least_zero(
        VELOCITY_RESOLUTION, "velocity resolution", "m/s", 0.0, 1e6,
        "Size of one count of the velocity sensor; 0: none.",
    ),
    _at_least_zero(
        COMMAND_RESOLUTION, "command resolution", "N", 0.0, 1e9,
        "Size of one step of the D/A converter of the command; 0: none.",
    ),
    _at_least_zero(
        POSITION_NOISE, "position noise", "m", 0.0, 1e6,
        "Standard deviation of the white noise on each sensed position.",
    ),
    _at_least_zero(
        VELOCITY_NOISE, "velocity noise", "m/s", 0.0, 1e6,
        "Standard deviation of the white noise on each sensed velocity.",
    ),
    _any(POSITION_BIAS, "position bias", "m", 0.0, 1e6, "Constant error of the sensed position."),
    _any(
        VELOCITY_BIAS, "velocity bias", "m/s", 0.0, 1e6, "Constant error of the sensed velocity."
    ),
    _at_least_zero(
        POSITION_BIAS_WALK, "position bias walk", "m/s^0.5", 0.0, 1e6,
        "Random walk of the position bias: its standard deviation after one second.",
    ),
    _at_least_zero(
        VELOCITY_BIAS_WALK, "velocity bias walk", "m/s^1.5", 0.0, 1e6,
        "Random walk of the velocity bias: its standard deviation after one second.",
    ),
    Parameter(
        VELOCITY_FILTER, "velocity filter cutoff", "rad/s", INF, 1e-3, 1e9, True,
        "Cutoff of the first-order filter of the differenced velocity; inf: none.",
    ),
    Parameter(
        FORCE_LIMIT, "force limit", "N", INF, 1e-9, 1e12, True,
        "Largest force of the actuator, in either direction; inf: none.",
    ),
    Parameter(
        FORCE_RATE_LIMIT, "force rate limit", "N/s", INF, 1e-9, 1e15, True,
        "Largest rate of change of the force; inf: none.",
    ),
    Parameter(
        STALL_FORCE, "stall force", "N", INF, 1e-9, 1e12, True,
        "Force of the torque-speed line at zero speed; inf: no such line.",
    ),
    Parameter(
        NO_LOAD_SPEED, "no-load speed", "m/s", INF, 1e-9, 1e9, True,
        "Speed at which the torque-speed line reaches zero force; inf: no such line.",
    ),
    _any(
        SETPOINT, SETPOINT, "m", 0.1, 1e6,
        "Height of the setpoint's step at time 0, or amplitude of its motion; of a robot, from its"
        " posture (default there: 0).",
    ),
    _any(
        INITIAL_POSITION, "initial position", "m", 0.0, 1e6,
        "Position at time 0; of a robot, from its posture.",
    ),
    _any(INITIAL_VELOCITY, "initial velocity", "m/s", 0.0, 1e6, "Velocity at and before time 0."),
    _at_least_zero(
        REST_AMPLITUDE, "amplitude at rest", "m", 0.0, 1e6,
        "Motion at the end that counts as at rest, where noise never lets it end; of a robot:"
        " 0.002, or a tenth of a count where there is quantisation and no noise.",
    ),
    _at_least_zero(
        PAYLOAD, PAYLOAD, "kg", 0.0, 1e6,
        "Robots only: mass added to `plant.payload_body`, the heaviest body where none is given.",
    ),
    Parameter(
        INERTIA_SCALE, "inertia scale", "1", 1.0, 1e-3, 1e3, False,
        "Robots only: factor on mass and inertia of all that the driven joints move.",
    ),
    _at_least_zero(
        JOINT_DAMPING, "joint damping", "N s/m", 0.0, 1e9,
        "Viscous damping of the joint itself; of a robot: added to that of the driven joints.",
    ),
    _any(
        JOINT_STIFFNESS, "joint stiffness", "N/m", 0.0, 1e9,
        "Stiffness of the joint itself about position 0: a spring, or gravity, negative where that"
        " topples the joint.",
    ),
    _at_least_zero(
        JOINT_ARMATURE, "added armature", "kg", 0.0, 1e6,
        "Robots only: rotor inertia added to the driven joints.",
    ),
    _at_least_zero(
        JOINT_FRICTION, "added joint friction", "N", 0.0, 1e9,
        "Robots only: dry friction added to the driven joints."),
    _at_least_zero(
        CONTACT_FRICTION, "contact friction scale", "1", 1.0, 1e3,
        "Robots only: factor on the friction of all contacts.",
    ),
)  # fmt: skip

PARAMETERS: dict[str, Parameter] = {parameter.name: parameter for parameter in _TABLE}

# What a robot's model may bring itself; not a number where it does not.
OF_MODEL = (KP, KD, WN, ZETA, DELAY, SETPOINT_DELAY, FORCE_LIMIT)
# Other defaults for a robot: it holds its posture, and trembles a little where it is noisy, which
# `jaxact.simulation.starts.rest_amplitude` puts a number to.
OF_ROBOTS = {SETPOINT: 0.0, REST_AMPLITUDE: math.nan}
# What changes the model of a robot, and has no meaning for a joint.
ROBOT_ONLY = (PAYLOAD, INERTIA_SCALE, JOINT_ARMATURE, JOINT_FRICTION, CONTACT_FRICTION)
# What makes a joint more than a bare mass. A robot has the springs of its model, and no others.
OF_JOINT = (JOINT_DAMPING, JOINT_STIFFNESS)
# What changes the model of a plant that MuJoCo simulates.
OF_PLANT = (*ROBOT_ONLY, *OF_JOINT)
# Delays within the loop, of which only the sum counts; and all.
LOOP_DELAYS = (DELAY, MEASUREMENT_DELAY, OUTPUT_DELAY)
DELAYS = (*LOOP_DELAYS, SETPOINT_DELAY)
# What is wrong with what a drive senses and commands.
RESOLUTIONS = (POSITION_RESOLUTION, VELOCITY_RESOLUTION, COMMAND_RESOLUTION)
NOISES = (POSITION_NOISE, VELOCITY_NOISE)
BIASES = (POSITION_BIAS, VELOCITY_BIAS)
WALKS = (POSITION_BIAS_WALK, VELOCITY_BIAS_WALK)
ERRORS = (*RESOLUTIONS, *NOISES, *BIASES, *WALKS)
# What bounds the force: by itself, its rate, and by the speed of the joint.
LIMITS = (FORCE_LIMIT, FORCE_RATE_LIMIT, STALL_FORCE, NO_LOAD_SPEED)
# What may be uncertain of a drive.
OF_DRIVES = (WN, ZETA, *LOOP_DELAYS)
# What one number serves for all joints of a robot.
SHARED = (
    GAIN_SCALE, MASS, CONTROL_RATE, POLICY_RATE, PAYLOAD, CONTACT_FRICTION, REST_AMPLITUDE,
)  # fmt: skip

INERTIA = "inertia"  # given instead of the mass, it says that the joint is rotary

# Actuators by name: (wn [rad/s], zeta), as the reference study identified them: HyQ is hydraulic,
# StarlETH has springs in series.
PRESETS: dict[str, tuple[float, float]] = {
    "ideal": (INF, 1.0),
    "hyq": (800.0, 0.45),
    "starleth": (110.0, 0.9),
}

ALIASES = {parameter.long_name.replace(" ", "_"): parameter.name for parameter in _TABLE} | {
    "effort_limit": FORCE_LIMIT,
    "added_joint_damping": JOINT_DAMPING,
    INERTIA: MASS,
}  # short names by the others

LINEAR = (KP, KD, MASS, *OF_DRIVES, VELOCITY_FILTER, *OF_JOINT)
"""What the stability of a linear loop depends on, beside its control rate."""


def canonical(key: str) -> str:
    """The key with the short name of a parameter given by either name; any other key as it is."""
    name, at, pattern = key.partition("@")
    return (name if name in PARAMETERS else ALIASES.get(name, name)) + at + pattern


def base(key: str) -> str:
    """The parameter of a key: `kp@.*_knee`, the stiffness of some joints, is a `kp`."""
    return key.partition("@")[0]


def mass_word(unit: str | None) -> str:
    """What the mass of a joint is called whose position is in `unit`."""
    return INERTIA if unit == "rad" else MASS


def of(key: str, unit: str | None = None) -> Parameter:
    """The parameter of a key of this table, its long name telling the joints it is meant for.

    Args:
        key: short name, or a key of it for some joints.
        unit: of the joint's position, "m" or "rad"; None: m.
    """
    name, _, pattern = key.partition("@")
    parameter = PARAMETERS[name]
    if unit == "rad":
        words = "moved inertia" if name == MASS else parameter.long_name
        parameter = replace(parameter, unit=turned(parameter.unit), long_name=words)
    if not pattern:
        return parameter
    return replace(parameter, name=key, long_name=f"{parameter.long_name} of {pattern}")


def known(key: str) -> bool:
    """Whether a key names a parameter, of all joints or of those that match a pattern."""
    name, at, pattern = key.partition("@")
    if not at:
        return name in PARAMETERS
    return name in PARAMETERS and name not in SHARED and _is_pattern(pattern)


def _is_pattern(text: str) -> bool:
    try:
        re.compile(text)
    except re.error:
        return False
    return bool(text)


def check(name: str, value: object, key: str = "", unit: str | None = None) -> float:
    """The value of a parameter as a float, if it is a number within the parameter's bounds.

    Args:
        name: short name of the parameter, or a key of it for some joints.
        value: what was given.
        key: how the message names it, the parameter's own name by default.
        unit: of the joint's position, as for `of`.

    Raises:
        UserError: anything that is not a number, is NaN, or is out of bounds.
    """
    parameter = of(name, unit)
    key = key or name
    number = as_number(value)
    if number is None or math.isnan(number):
        raise UserError(
            f"{key} = {shown(value)} is not a number; allowed: {parameter.allowed}"
            f" ({parameter.long_name})"
        )
    inside = parameter.minimum <= number <= parameter.maximum
    if not (inside or (parameter.infinite and number == INF)):
        raise UserError(
            f"{key} = {shown(value)} is out of range; allowed: {parameter.allowed}"
            f" ({parameter.long_name})"
        )
    return number


def check_actuator(value: object, key: str = "actuator") -> str:
    """The name of an actuator preset, if there is one of that name.

    Raises:
        UserError: any other name.
    """
    if not isinstance(value, str) or value not in PRESETS:
        raise UserError(
            f"{key} = {shown(value)} is not an actuator preset; {nearest(value, PRESETS)}"
        )
    return value


def as_number(value: object) -> float | None:
    """An int or a float as a float, None for anything else; true and false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return INF if value > 0 else -INF
