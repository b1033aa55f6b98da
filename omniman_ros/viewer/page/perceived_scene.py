"""What the robot perceives: map, scan, tracked obstacles, contacts, shapes, and its plan."""

import numpy as np
import viser

from omniman_ros.core.arrays import Array
from omniman_ros.viewer import style
from omniman_ros.viewer.body_view import BodyView, Nearest, PlanView
from omniman_ros.viewer.floor_shapes import disc
from omniman_ros.viewer.map_image import MapImage
from omniman_ros.viewer.meshes import rotation, sphere
from omniman_ros.viewer.page.draggable_markers import OPAQUE, MeshBatch
from omniman_ros.viewer.page.floor_scene import SceneLine
from omniman_ros.viewer.perceived import (
    Contact,
    Perceived,
    Tracks,
    uncertainty_circles,
    velocity_arrows,
)

MAP_HEIGHT = 0.002  #: Height of the map above the floor, below all lines [m]
TRACK_HEIGHT = 0.05  #: Height of the arrows of tracked obstacles [m]
POINT_SIZE = 0.035  #: Size of a point of a scan [m]
CONTACT_RADIUS = 0.06  #: Radius of the ball at a contact [m]
TRANSPARENT = 0.35  #: Opacity of the robot's shapes


class PerceivedScene:
    """Draws what the robot perceives."""

    def __init__(self, api: viser.SceneApi, root: str) -> None:
        self._map = _Map(api, f"{root}/map")
        self._scan = _Points(api, f"{root}/scan")
        self._tracks: Tracks | None = None
        self._arrows = SceneLine(api, f"{root}/track_arrows", style.TRACK, 4.0, 1)
        self._circles = SceneLine(api, f"{root}/track_circles", style.TRACK, 1.5, 1)
        self._contacts = MeshBatch(api, f"{root}/contacts", sphere(), style.CONTACT, OPAQUE)
        self._body = _Body(api, f"{root}/shapes")
        self._plan: PlanView | None = None
        self._ghosts = SceneLine(api, f"{root}/plan_ghosts", style.PLAN, 2.0, 1)
        self._avoided = SceneLine(api, f"{root}/plan_nearest", style.NEAREST, 4.0, 1)

    def draw(self, perceived: Perceived, layers: frozenset[str]) -> None:
        """Draw the layers with these names, see `perceived.LAYERS`, and hide the others."""
        self._map.draw(perceived.map if "map" in layers else None)
        self._scan.draw(perceived.scan.points, perceived.scan.version, shown="scan" in layers)
        self._draw_tracks(perceived.tracks if "tracked obstacles" in layers else None)
        contacts = perceived.contacts.values() if "contacts" in layers else ()
        self._draw_contacts(list(contacts))
        self._body.draw(perceived.body if "shapes for distances" in layers else None)
        self._draw_plan(perceived.plan if "plan of the body" in layers else None)

    def _draw_plan(self, plan: PlanView | None) -> None:
        if plan is self._plan:
            return
        self._plan = plan
        self._ghosts.draw(np.zeros((0, 2, 3)) if plan is None else plan.ghosts)
        self._avoided.draw(_to_nearest(None if plan is None else plan.nearest))

    def _draw_tracks(self, tracks: Tracks | None) -> None:
        if tracks is self._tracks:
            return
        self._tracks = tracks
        for line, make in ((self._arrows, velocity_arrows), (self._circles, uncertainty_circles)):
            flat = np.zeros((0, 2, 2)) if tracks is None else make(tracks)
            heights = np.full((*flat.shape[:2], 1), TRACK_HEIGHT)
            line.draw(np.concatenate((flat, heights), axis=2))

    def _draw_contacts(self, contacts: list[Contact]) -> None:
        places = np.array([contact.position for contact in contacts]).reshape(-1, 3)
        self._contacts.draw(
            places, _upright(len(places)), np.full((len(places), 3), CONTACT_RADIUS), None
        )


class _Map:
    """The map as an image, which is sent again only where it has changed."""

    def __init__(self, api: viser.SceneApi, name: str) -> None:
        empty = np.zeros((1, 1, 4), dtype=np.uint8)
        self._handle = api.add_image(
            name,
            empty,
            1.0,
            1.0,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._shown: MapImage | None = None

    def draw(self, image: MapImage | None) -> None:
        handle, shown = self._handle, self._shown
        if image is None or image is shown:
            handle.visible = image is not None
            return
        if shown is None or image.pixels is not shown.pixels:
            handle.image = image.pixels
        handle.render_width, handle.render_height = image.size
        x, y, theta = image.middle
        handle.position = np.array([x, y, MAP_HEIGHT])
        handle.wxyz = rotation(theta)
        handle.visible = True
        self._shown = image


class _Points:
    def __init__(self, api: viser.SceneApi, name: str) -> None:
        self._version = 0
        self._handle = api.add_point_cloud(
            name,
            np.zeros((1, 3), dtype=np.float32),
            style.SCAN,
            point_size=POINT_SIZE,
            point_shape="circle",
            precision="float32",
            point_shading="flat",
            visible=False,
        )

    def draw(self, points: Array, version: int, *, shown: bool) -> None:
        """Draw points (k, 3) [m], whose version changes whenever they do."""
        if shown and version != self._version and len(points):
            self._version = version
            self._handle.points = points.astype(np.float32)
        self._handle.visible = shown and bool(len(points))


class _Body:
    """The robot's shapes: capsules of the arm, rectangles on the floor, a line to the nearest."""

    def __init__(self, api: viser.SceneApi, name: str) -> None:
        tube, ball = disc(1.0, 1.0), sphere()
        self._tubes = MeshBatch(api, f"{name}/tubes", tube, style.CAPSULE, TRANSPARENT)
        self._balls = MeshBatch(api, f"{name}/balls", ball, style.CAPSULE, TRANSPARENT)
        self._footprint = SceneLine(api, f"{name}/footprint", style.FOOTPRINT, 2.0, 3)
        self._nearest = SceneLine(api, f"{name}/nearest", style.NEAREST, 4.0, 3)
        self._drawn: BodyView | None = None

    def draw(self, body: BodyView | None) -> None:
        if body is self._drawn:
            return
        self._drawn = body
        if body is None:
            for batch in (self._tubes, self._balls):
                batch.draw(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), None)
            for line in (self._footprint, self._nearest):
                line.draw(np.zeros((0, 2, 3)))
            return
        way = body.end - body.start
        length = np.linalg.norm(way, axis=1)
        scales = np.column_stack((body.radius, body.radius, length))
        middles = 0.5 * (body.start + body.end)
        self._tubes.draw(middles, _from_upright(way / length[:, None]), scales, None)
        ends = np.concatenate((body.start, body.end))
        sizes = np.tile(body.radius[:, None], (2, 3))
        self._balls.draw(ends, _upright(len(ends)), sizes, None)
        corners = body.footprint
        edges = np.stack((corners, np.roll(corners, -1, axis=1)), axis=2).reshape(-1, 2, 2)
        heights = np.full((len(edges), 2, 1), TRACK_HEIGHT)
        self._footprint.draw(np.concatenate((edges, heights), axis=2))
        self._nearest.draw(_to_nearest(body.nearest))


def _to_nearest(nearest: Nearest | None) -> Array:
    """Return the line (s, 2, 3) to what is nearest, if anything is [m]."""
    return np.zeros((0, 2, 3)) if nearest is None else nearest.line[None]


def _upright(count: int) -> Array:
    """Return quaternions (count, 4) of no rotation."""
    return np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))


def _from_upright(directions: Array) -> Array:
    """Return quaternions (k, 4), (w, x, y, z), that turn z into unit vectors (k, 3)."""
    x, y, z = directions.T
    w = np.sqrt(0.5 * np.maximum(1.0 + z, 1e-12))
    # Where the direction is downwards, any horizontal axis will do.
    result = np.column_stack((w, -y / (2.0 * w), x / (2.0 * w), np.zeros(len(w))))
    result[z < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return result
