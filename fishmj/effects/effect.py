"""Definition of an effect: one imperfection of a robot, its water, its tank or its sensors that a simulation may lack.

An effect is data plus small pure functions at named sites (sites.py). At the null values of its parameters it is the identity,
bit for bit. The functions use arithmetic and the array namespace `xp` only, so one definition serves the planar chain, its
compiled form, JAX, the beat-averaged body and the servo on a bench.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects.robot_scales import DEFAULT, QUANTITIES, RobotScales, scaled

STAGES = ("actuator", "timing", "inertia", "hydrodynamics", "environment", "measurement")
CHANNELS = ("joint", "position", "heading", "power")  # in which an effect shows
CLOCKS = ("command", "joint", "pose", "power", "velocity")  # what a transport delay may delay
STREAMS = ("command", "flow", "seen")  # what a stochastic effect may draw
# where an effect acts in a robot described in MJCF; base: of one that is fixed; thrusters: all actuators on sites together
ROBOT_SITES = ("joint", "actuator", "body", "robot", "base", "thrusters")
AT = "@"  # between the kind of an effect and its site on such a robot
LAW_MATH = ("copysign", "cos", "exp", "pi", "sin")  # of `math`, in the law of an effect of such a robot


def kind_of(name: str) -> str:
    """The effect of the catalogue that a name is of: `payload` of `payload@forearm`."""
    return name.partition(AT)[0]


def site_of(name: str) -> str:
    """The site of an effect: `forearm` of `payload@forearm`, "" without one."""
    return name.partition(AT)[2]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect, SI.

    null: value without effect. low, high: physical bounds. typical: (small, large) expected values, probed by a search and drawn
    by domain randomisation; a signed parameter may lie on either side of its null, mirrored there.
    shape: the parameter shapes the effect but does not cause it: while the others are at their null, any value is the identity.
    fine: only a value within a fraction of a per cent explains anything, so a search must try many.
    joint: the joint, from 1, that it belongs to; 0: it belongs to no single one.
    of: one of robot_scales.QUANTITIES, which null, bounds and typical sizes are in proportion to; stated for the default fish.
    """

    name: str
    unit: str
    null: float = 0.0
    low: float
    high: float
    typical: tuple[float, float]
    about: str = ""
    shape: bool = False
    fine: bool = False
    joint: int = 0
    of: str = ""

    def __post_init__(self):
        if self.name in ("joint", "robot"):
            what = {"joint": "the joint's number", "robot": "the robot's constants"}[self.name]
            raise ConfigError(f"effect parameter {self.name}: that name is {what} at a site (p.{self.name}); choose another")
        if self.of not in ("", *QUANTITIES):
            raise ConfigError(f"effect parameter {self.name}: of = {self.of!r}; choose one of {', '.join(QUANTITIES)}")
        if not (self.low <= self.null <= self.high and self.typical[0] < self.typical[1]):
            raise ConfigError(
                f"effect parameter {self.name}: needs low <= null <= high and typical[0] < typical[1], got low = {self.low},"
                f" null = {self.null}, high = {self.high}, typical = {self.typical}"
            )

    @property
    def signed(self) -> bool:
        """Returns True if both sides of the null are possible."""
        return self.low < self.null < self.high and not self.shape

    @property
    def probe(self) -> float:
        """A value of typical size."""
        return self.typical[1]

    def on_robot(self, robot: RobotScales) -> "Parameter":
        """The parameter with null, bounds and typical sizes of this robot."""
        if not self.of or robot == DEFAULT:
            return self
        null, low, high, small, large = (scaled(x, self.of, robot) for x in (self.null, self.low, self.high, *self.typical))
        return replace(self, null=null, low=low, high=high, typical=(small, large))


class RobotForm(NamedTuple):
    """Form of an effect in a robot described in MJCF: one effect at each site of a kind, such as each joint.

    site: one of ROBOT_SITES. parameters: null, bounds and typical sizes in multiples of `scale` at the site: torque [N m],
    damping [N m s/rad], drag [N m s2/rad2], inertia [kg m2], stiffness [N m/rad], mass [kg], length [m], command [of the
    actuator], rate [rad/s], time [s/rad]; "" where they are SI; a tuple has one for each. Functions (None = not used):

        fields(site, p)                     changes fields of site.m, an MjModel
        reading(p) -> (scale, zero)         a joint reads scale x angle - zero
        command(p, t, c) -> (t, c)          commands (T,) of one actuator and their stamps (T,); their mean, if they are drawn
        scatter(rng, p, t, c) -> (t, c)     one draw of commands that chance or a hidden state changes,
                                            of an effect of one parameter
        simulated(p, t, c) -> (t, c)        the commands for a simulation, where they are not the mean
        law(joint, memory, *parameters) -> (torque, friction)     what no field of MuJoCo holds, at each step: a torque on the
                                            joint, and a limit of dry friction on top of the model's. joint: sites.JointMotion;
                                            memory: four numbers, zero at the start. Scalars, and the names of LAW_MATH only: its
                                            text is compiled for the search, and copied into the patch

    confusions: with other effects of such a robot.
    """

    site: str
    parameters: tuple[Parameter, ...]
    scale: str | tuple[str, ...] = ""
    fields: Callable | None = None
    reading: Callable | None = None
    command: Callable | None = None
    scatter: Callable | None = None
    simulated: Callable | None = None
    law: Callable | None = None
    confusions: tuple["Confusion", ...] = ()


@dataclass(frozen=True)
class Confusion:
    """Another effect with a similar signature, and the experiment that tells them apart."""

    other: str  # its name
    separates: str  # what tells them apart
    excitations: tuple[str, ...] = ()  # ids of fishmj.log.excitation, best first


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One entry of the catalogue.

    about, formula: one line each. source: of formula and magnitudes. shows: channels. native: MuJoCo's own means to model it, ""
    if only a hook can. Sites (None = not used), called with p, a namespace of this effect's parameters and `robot` (RobotScales):

        servo(xp, p, ServoDrive, memory, h) -> (ServoDrive, memory)     one joint, before the drive
        gear(xp, p, Gear, memory, h) -> (Gear, memory)                  one joint, after the drive
        fish(xp, p, Constants) -> Constants                             masses, coefficients
        flow(xp, p, FlowAt) -> FlowAt                                   water velocity at a place
        body(xp, p, BodyMotion, memory, h) -> (BodyMotion, memory)      forces on the whole body at the reference point
        water(xp, p, LocalWater, memory, h) -> (LocalWater, memory)     forces of the water on each link
        command(xp, p, command, memory, h) -> (command, memory)         one joint's command, rad, on its way to the servo
        measure(xp, p, Measured) -> Measured                            what the sensors report, whole records
        delays {clock: parameter}                               transport delay of a clock, s
        drifts {clock: parameter}                               rate of a clock, 1 = true: the delay grows by (rate - 1) t

    memory: initial values of a site's memory, one set a joint at the sites servo, gear and command.
    rank: at a site effects act in order of rank, then as listed: upstream parts of the robot first.
    Facts for the tests of every effect:
        handed      parameters whose sign a mirror turns
        one_sided   it pulls or pushes to one side only: a mirrored fish does not swim the mirrored way
        stores      it gives back energy that it took, as a spring: it may push
        unplanted   why the second robot (gap/laboratory/virtual_robot/catalogue.py) does not hide it; "": it does
        planted     why it hides it in sizes that are not typical here; "": the ranges overlap
    robot: its form in a robot described in MJCF; None: it has none. An effect of such robots only has no parameters of its own.
    stream: one of STREAMS, of an effect that is drawn once a run; it changes the scatter between replicates, not their mean. ""
    of any other.
    """

    name: str
    stage: str
    about: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...] = ()
    shows: tuple[str, ...] = ()
    confusions: tuple[Confusion, ...] = ()
    native: str = ""
    memory: tuple[float, ...] = ()
    rank: int = 0
    servo: Callable | None = None
    gear: Callable | None = None
    fish: Callable | None = None
    flow: Callable | None = None
    body: Callable | None = None
    water: Callable | None = None
    command: Callable | None = None
    measure: Callable | None = None
    delays: dict[str, str] = field(default_factory=dict)
    drifts: dict[str, str] = field(default_factory=dict)
    stream: str = ""
    handed: tuple[str, ...] = ()
    one_sided: bool = False
    stores: bool = False
    unplanted: str = ""
    planted: str = ""
    robot: RobotForm | None = None

    def __post_init__(self):
        if self.stage not in STAGES:
            raise ConfigError(f"effect {self.name}: stage {self.stage!r}; choose one of {', '.join(STAGES)}")
        wrong = set(self.shows) - set(CHANNELS) | set(self.delays | self.drifts) - set(CLOCKS)
        if wrong:
            raise ConfigError(f"effect {self.name}: unknown channels or clocks {sorted(wrong)}")
        mine = {p.name for p in (*self.parameters, *(self.robot.parameters if self.robot else ()))}
        unknown = {*self.delays.values(), *self.drifts.values(), *self.handed} - mine
        if unknown:
            raise ConfigError(f"effect {self.name}: delays or handed name {sorted(unknown)}, which are no parameters of it")
        if self.stream not in ("", *STREAMS):
            raise ConfigError(f"effect {self.name}: stream {self.stream!r}; choose one of {', '.join(STREAMS)}")
        if self.robot is not None and self.robot.site not in ROBOT_SITES:
            raise ConfigError(f"effect {self.name}: robot site {self.robot.site!r}; choose one of {', '.join(ROBOT_SITES)}")
        if not self.swims and self.robot is None:
            raise ConfigError(f"effect {self.name}: acts at no site")
        if self.memory and len(self.remembering) != 1:
            raise ConfigError(f"effect {self.name}: memory belongs to one site, got {self.sites}")

    @property
    def stochastic(self) -> bool:
        """Returns True if it is drawn once a run."""
        return bool(self.stream)

    @property
    def swims(self) -> bool:
        """Returns True if a fish can have it."""
        return bool(self.sites or self.delays or self.stochastic)

    @property
    def sites(self) -> tuple[str, ...]:
        """Names of the sites at which it acts, delays aside."""
        names = ("servo", "gear", "fish", "flow", "body", "water", "command", "measure")
        return tuple(name for name in names if getattr(self, name) is not None)

    @property
    def remembering(self) -> tuple[str, ...]:
        """Sites that take memory."""
        return tuple(s for s in self.sites if s in ("servo", "gear", "body", "water", "command"))

    def on_joints(self, joints: int) -> "Effect":
        """The effect without the parameters of joints that a robot with `joints` joints does not have."""
        gone = {p.name for p in self.parameters if p.joint > joints}
        if not gone:
            return self
        kept = tuple(p for p in self.parameters if p.name not in gone)
        return replace(self, parameters=kept, handed=tuple(name for name in self.handed if name not in gone))

    def on_robot(self, robot: RobotScales) -> "Effect":
        """The effect with null, bounds and typical sizes of this robot; itself if none depends on it."""
        own = tuple(p.on_robot(robot) for p in self.parameters)
        return self if own == self.parameters else replace(self, parameters=own)

    def parameter(self, name: str) -> Parameter:
        """One parameter by name. Raises UnknownName."""
        found = {p.name: p for p in self.parameters}
        if name not in found:
            raise UnknownName(f"parameter of {self.name}", name, found)
        return found[name]

    @property
    def null(self) -> tuple[float, ...]:
        """Parameter values without effect."""
        return tuple(p.null for p in self.parameters)
