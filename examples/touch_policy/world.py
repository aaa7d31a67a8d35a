"""A simulated task in which touch decides: grip a ball, and sort it by its hardness.

A gripper stands open above a ball. It has to go down, close until it presses with a certain force,
lift the ball, and carry it to the right if it is hard, to the left if it is soft. To the camera all
balls look the same: it is shown a ball of the mean diameter, whatever the true one is. Where the
contact begins, how far to close and where to go can be felt only.

The ball and the gel are springs in series. A soft ball flattens by `give` times as much as it
presses into the gel, so its imprint is wider than that of a hard one under the same force.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.simulation.camera import PlacedMesh, WristCamera, make_camera
from exumi_data.simulation.gel import Contact, GelPad
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.meshes import Mesh, finger_mesh, object_mesh
from exumi_data.store import jpeg

__all__ = [
    "ABOVE_M",
    "BALL_HEIGHT_M",
    "BIN_M",
    "LATENCY_S",
    "PERIOD_MS",
    "SIDE",
    "STEP_MS",
    "TARGET_M",
    "Ball",
    "Outcome",
    "Sample",
    "Senses",
    "World",
    "make_ball",
    "make_senses",
]

SIDE = {"rgb": 48, "tactile_left": 32}
"""Height and width of the images, pixels."""
PERIOD_MS = {"rgb": 100, "tactile_left": 40, "pose": 20, "width": 20}
"""Distance of two samples of each stream."""
LATENCY_S = {"rgb": 0.08, "tactile_left": 0.04, "pose": 0.02, "width": 0.01}
"""How long after its capture a sample is at hand."""
STEP_MS = 10
"""Step of the simulation."""
TARGET_M = 0.7e-3
"""How deep the ball is to press into the gel: the force that is wanted."""
BIN_M = 0.08
"""How far to either side the bins are."""
BALL_HEIGHT_M = 0.012
"""Height of the ball's middle on the table."""
ABOVE_M = 0.04
"""How far above it the gripper begins."""

_DIAMETER_M, _SPREAD_M = 0.024, 0.004
_HARD, _SOFT = (0.0, 0.3), (0.9, 1.5)  # give: flattening per indentation of the gel
_LOW_M, _HIGH_M = 0.5 * TARGET_M, 1.5 * TARGET_M  # dropped below, crushed above
_REACHED_M = 0.6 * BIN_M
_DOWN = (1.0, 0.0, 0.0, 0.0)
_BESIDE_M = np.array([0.012, 0.012, 0.006])  # that near, the fingers close on the ball
_QUALITY = 95
_SPEED_M_S, _CLOSING_M_S = 0.3, 0.03


Sample = bytes | np.ndarray | float
"""A JPEG file, a pose (7,), or a width in metres."""


@dataclass(frozen=True)
class Ball:
    """What is to be felt. Lengths in metres.

    Attributes
    ----------
    diameter_m : float
    give : float
        How much the ball flattens per indentation of the gel.
    u_m, v_m : float
        Where the ball's middle lies on the pad.
    x_m : float
        Where it stands on the table.
    """

    diameter_m: float
    give: float
    u_m: float
    v_m: float
    x_m: float

    @property
    def is_hard(self) -> bool:
        """Whether it belongs to the right."""
        return self.give <= _HARD[1]

    def depth_m(self, width_m: float) -> float:
        """Return how deep it presses into each gel at a width of the gripper."""
        return max(0.0, (self.diameter_m - width_m) / 2 / (1 + self.give))

    def width_m(self, depth_m: float) -> float:
        """Return the width at which it presses into each gel by a depth."""
        return self.diameter_m - 2 * depth_m * (1 + self.give)


def make_ball(rng: np.random.Generator, *, play: bool = False) -> Ball:
    """Draw a ball: hard or soft, or (to play with) anything between."""
    give = (_HARD[0], _SOFT[1]) if play else (_HARD, _SOFT)[int(rng.integers(2))]
    u, v = rng.uniform(-3e-3, 3e-3, 2)
    return Ball(
        diameter_m=_DIAMETER_M + float(rng.uniform(-_SPREAD_M, _SPREAD_M)),
        give=float(rng.uniform(*give)),
        u_m=float(u),
        v_m=float(v),
        x_m=float(rng.uniform(-0.005, 0.005)),
    )


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended."""

    gripped: bool
    """The ball was held at the end, and not crushed."""
    sorted: bool
    """The gripper came to the right bin, with or without the ball."""

    @property
    def success(self) -> bool:
        """Both."""
        return self.gripped and self.sorted


class World:
    """A gripper, a ball, and time. It follows targets exactly, but for its highest speeds.

    Parameters
    ----------
    ball : Ball
    width_m : float
        How wide the gripper is open at the beginning.
    """

    def __init__(self, ball: Ball, width_m: float) -> None:
        self.ball = ball
        self.time_ms = 0
        self.place = np.array([ball.x_m, 0.0, BALL_HEIGHT_M + ABOVE_M])
        self.width_m = width_m
        self._is_carried = self._is_crushed = False

    @property
    def depth_m(self) -> float:
        """How deep the ball presses into the gel."""
        return self.ball.depth_m(self.width_m) if self._is_carried or self._is_at_ball else 0.0

    @property
    def pose(self) -> np.ndarray:
        """X y z qx qy qz qw of the gripper, (7,) float64."""
        return np.concatenate((self.place, _DOWN))

    @property
    def _is_at_ball(self) -> bool:
        """Whether the fingers are beside the ball on the table."""
        return bool((np.abs(self.place - self._ball_place) < _BESIDE_M).all())

    @property
    def _ball_place(self) -> np.ndarray:
        return np.array([self.ball.x_m, 0.0, BALL_HEIGHT_M])

    @property
    def is_over(self) -> bool:
        """Whether the gripper has reached a bin, or crushed the ball."""
        return self._is_crushed or abs(float(self.place[0])) > _REACHED_M

    def step(self, place: npt.ArrayLike, width_m: float) -> None:
        """Move towards a place (3,) and a width for `STEP_MS`."""
        seconds = STEP_MS / 1e3
        way = np.asarray(place) - self.place
        length = float(np.linalg.norm(way))
        most = _CLOSING_M_S * seconds
        self.width_m += float(np.clip(width_m - self.width_m, -most, most))
        # A ball that is pressed enough comes with the gripper, until it is not.
        self._is_carried = self.depth_m >= _LOW_M
        self._is_crushed |= self.depth_m > _HIGH_M
        self.place = self.place + way * min(1.0, _SPEED_M_S * seconds / max(length, 1e-12))
        self.time_ms += STEP_MS

    def outcome(self) -> Outcome:
        """Return how it went so far."""
        x = float(self.place[0]) * (1 if self.ball.is_hard else -1)
        return Outcome(self._is_carried and not self._is_crushed, x > _REACHED_M)

    def ball_pose(self) -> np.ndarray:
        """Return where the ball is seen, (7,) float64."""
        place = self.place if self._is_carried else self._ball_place
        return np.concatenate((place, _DOWN))


@dataclass(frozen=True)
class Senses:
    """The sensors of one rig: the same pad and camera in all its episodes."""

    pad: GelPad
    camera: WristCamera
    ball: Mesh

    def due(self, world: World) -> dict[str, Sample]:
        """Return the samples that the sensors take now; frames are JPEG files."""
        made: dict[str, Callable[[], Sample]] = {
            "rgb": lambda: jpeg.encode(self.rgb(world), _QUALITY),
            "tactile_left": lambda: jpeg.encode(self.tactile(world), _QUALITY),
            "pose": lambda: world.pose,
            "width": lambda: world.width_m,
        }
        return {name: make() for name, make in made.items() if world.time_ms % PERIOD_MS[name] == 0}

    def tactile(self, world: World) -> np.ndarray:
        """Return what the left finger sees, (H, W, 3) uint8."""
        depth, ball = world.depth_m, world.ball
        contact = Contact(depth, ball.u_m, ball.v_m, 0.0)
        return self.pad.render(self._surface(ball, depth), contact, world.time_ms)

    def rgb(self, world: World) -> np.ndarray:
        """Return what the wrist camera sees, (H, W, 3) uint8."""
        scene = [PlacedMesh(self.ball, world.ball_pose(), layer=0)]
        for finger, sign in (("left", -0.5), ("right", 0.5)):
            mesh = finger_mesh("left" if finger == "left" else "right")
            scene.append(PlacedMesh(mesh.moved((sign * world.width_m, 0, 0)), world.pose, layer=1))
        return self.camera.render(world.pose, scene, world.time_ms)

    def _surface(self, ball: Ball, depth_m: float) -> np.ndarray:
        """Return the height map of the ball as it is flattened, (S, S) float32."""
        half = round(0.014 / self.pad.m_per_px)
        axis = np.arange(-half, half + 1) * self.pad.m_per_px
        radius = ball.diameter_m / 2
        away = axis**2 + axis[:, None] ** 2
        height = np.sqrt(np.maximum(radius**2 - away, 0.0)) - radius
        flattened = np.minimum(height + ball.give * depth_m, 0.0)
        return np.maximum(flattened, -0.006).astype(np.float32)


def make_senses(seed: int = 0) -> Senses:
    """Make the sensors of a rig."""
    big = object_mesh("ball")
    scale = _DIAMETER_M / np.ptp(big.vertices[:, 0])
    side = SIDE["tactile_left"]
    return Senses(
        make_pad((side, side), dotted=False, seed=seed),
        make_camera((SIDE["rgb"], SIDE["rgb"]), seed=seed),
        Mesh(big.vertices * scale, big.faces, big.colours),
    )
