"""What the robot perceives of its surroundings, as the page draws it."""

from dataclasses import dataclass, field

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.viewer.body_view import BodyView, PlanView
from omniman_ros.viewer.lines import Line, outlines, segments
from omniman_ros.viewer.map_image import MapImage

#: Layers that can be switched on the page, by their labels, and whether each is on at first
LAYERS = {
    "scan": True,
    "map": True,
    "tracked obstacles": True,
    "contacts": True,
    "plan of the body": True,
    "shapes for distances": False,
}
FRESHNESS_TIMEOUT = 1.0  #: Age from which a value no longer counts as current [s]; maps stay
DEVIATIONS = 2.0  #: Radius of the circles of uncertainty, in standard deviations
ARROW_TIME = 1.0  #: Time after which a tracked obstacle will be at the tip of its arrow [s]
SLOWEST = 0.05  #: Speed from which a tracked obstacle has an arrow [m/s]
HEAD = 0.12  #: Length of the head of an arrow [m]


@dataclass(frozen=True)
class Tracks:
    """M tracked obstacles."""

    centers: Array  #: (M, 2) centres in `odom` [m]
    velocities: Array  #: (M, 2) velocities in `odom` [m/s]
    radii: Array  #: (M,) radii [m]
    position_deviations: Array  #: (M,) standard deviations of either coordinate [m]
    velocity_deviations: Array  #: (M,) standard deviations of either component [m/s]

    @staticmethod
    def none() -> "Tracks":
        """Return an empty set."""
        return Tracks(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self.radii)


def velocity_arrows(tracks: Tracks) -> Array:
    """Return arrows to where tracked obstacles will be after `ARROW_TIME`, as (s, 2, 2) [m]."""
    speeds = np.hypot(*tracks.velocities.T)
    moving = speeds > SLOWEST
    start, way = tracks.centers[moving], ARROW_TIME * tracks.velocities[moving]
    tip, along = start + way, way / (ARROW_TIME * speeds[moving, None])
    left = np.column_stack((-along[:, 1], along[:, 0]))
    sides = [tip - HEAD * along + 0.5 * sign * HEAD * left for sign in (-1.0, 1.0)]
    pieces = [np.stack((end, tip), axis=1) for end in (start, *sides)]
    result: Array = np.concatenate(pieces)
    return result


def uncertainty_circles(tracks: Tracks) -> Array:
    """Return circles within which tracked obstacles probably are, as segments (s, 2, 2) [m].

    For each obstacle there is a circle around its disc, which counts the uncertainty of the
    position, and one around the tip of its arrow, which counts that of the velocity.
    """
    around = tracks.radii + DEVIATIONS * tracks.position_deviations
    tips = tracks.centers + ARROW_TIME * tracks.velocities
    at_tip = DEVIATIONS * ARROW_TIME * tracks.velocity_deviations
    centers = np.concatenate((tracks.centers, tips))
    radii = np.concatenate((around, at_tip))
    points = outlines(centers, np.column_stack((radii, radii)), np.zeros(len(radii)))
    pieces = segments(points)
    result: Array = pieces[np.isfinite(pieces).all(axis=(1, 2))]
    return result


@dataclass(frozen=True)
class Contact:
    """A contact of the robot in a simulated world."""

    text: str  #: What touches what
    position: Array  #: (3,) where, in the frame of the simulation [m]
    force: float  #: Magnitude of the force [N]
    received_at: float  #: Time at which it was received [s]


@dataclass
class Perceived:
    """What the page shows of scanners, tracker, collision monitor and physics world."""

    #: Points (k, 3) that the scanners' beams met, in `odom` [m]
    scan: Line = field(default_factory=lambda: Line(np.empty((0, 3))))
    map: MapImage | None = None  #: The map of what stands; None while it has no place
    tracks: Tracks = field(default_factory=Tracks.none)  #: Tracked obstacles
    contacts: dict[str, Contact] = field(default_factory=dict)  #: Contacts by their names
    #: Shares that the monitor leaves; None: silent
    speed_fractions: tuple[float, float] | None = None
    tip_over_margin: float | None = None  #: Tip-over margin [m]; None while it is not received
    body: BodyView | None = None  #: Shapes for distances; None while they are not shown
    plan: PlanView | None = None  #: Plan of the whole body; None while there is none
    _scans: dict[str, tuple[Array, float]] = field(default_factory=dict)
    _received_at: dict[str, float] = field(default_factory=dict)

    def update_scan(self, topic: str, points: Array, now: float) -> None:
        """Store the points (k, 3) of one scanner in `odom` [m], received at `now` [s]."""
        self._scans[topic] = points, now
        self._join_scans()

    def update_tracks(self, tracks: Tracks, now: float) -> None:
        """Store the tracked obstacles, received at `now` [s]."""
        self.tracks = tracks
        self._received_at["tracks"] = now

    def update_plan(self, plan: PlanView, now: float) -> None:
        """Store the plan of the whole body, received at `now` [s]."""
        self.plan = plan
        self._received_at["plan"] = now

    def update_margin(self, margin: float, now: float) -> None:
        """Store the tip-over margin [m], received at `now` [s]."""
        self.tip_over_margin = margin
        self._received_at["margin"] = now

    def update_speed_fractions(self, fractions: tuple[float, float], now: float) -> None:
        """Store the fractions of the speed limits for platform and arm, received at `now` [s]."""
        self.speed_fractions = fractions
        self._received_at["shares"] = now

    def sample(self, now: float) -> None:
        """Discard what was received too long before `now` [s]."""
        old = [topic for topic, (_, at) in self._scans.items() if _is_old(at, now)]
        for topic in old:
            del self._scans[topic]
        if old:
            self._join_scans()
        if len(self.tracks) and self._is_old("tracks", now):
            self.tracks = Tracks.none()
        if self._is_old("plan", now):
            self.plan = None
        if self._is_old("margin", now):
            self.tip_over_margin = None
        if self._is_old("shares", now):
            self.speed_fractions = None
        self.contacts = {
            name: contact
            for name, contact in self.contacts.items()
            if not _is_old(contact.received_at, now)
        }

    def _is_old(self, name: str, now: float) -> bool:
        return _is_old(self._received_at.get(name, -np.inf), now)

    def _join_scans(self) -> None:
        self.scan.set(np.concatenate([np.empty((0, 3)), *(p for p, _ in self._scans.values())]))


def _is_old(received_at: float, now: float) -> bool:
    """Return whether something is too old; or newer than now, as after time went back."""
    return not 0.0 <= now - received_at < FRESHNESS_TIMEOUT
