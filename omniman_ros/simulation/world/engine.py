"""MuJoCo: a compiled model, its state, and what is asked of it. `distances` imports it, too."""

import itertools
import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.model.floor import FLOOR
from omniman_ros.simulation.world.model.world import WorldModel

Indices = NDArray[np.int32]  #: Indices of shapes
#: Corners of a cube, (8, 3)
SIGNS: Array = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


class Engine:
    """A model that is stepped; positions are always those at the end of the latest step.

    A step has two halves: :meth:`advance` to the new state, after which the contacts are still
    those of the step and have forces, and :meth:`refresh`, which finds positions and contacts of
    the new state.

    The arrays among the attributes are live views; :meth:`replace` makes new ones.
    """

    coordinates: Array  #: Coordinates of all joints; may be written before :meth:`refresh`
    velocities: Array  #: Velocities of all joints; may be written before :meth:`refresh`
    applied: Array  #: Forces and torques to apply at the joints in the next step; to be written
    bias: Array  #: Forces and torques that hold the joints against gravity and Coriolis forces
    damping: Array  #: Damping of all joints, implicit in a step; may be written
    dry_friction: Array  #: Dry friction of all joints; may be written
    shape_friction: Array  #: Coefficients of friction of all shapes; first column writable
    shape_positions: Array  #: Positions of all shapes in the world [m], (m, 3)

    def __init__(self, model: WorldModel) -> None:
        self._use(*self._compile(model))
        self.step_time = float(self._model.opt.timestep)  #: Length of a step [s]
        self.refresh()

    @staticmethod
    def _compile(source: WorldModel) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Compile a model, and give all tyres the same inverse mass, so the same stiffness."""
        model = mujoco.MjModel.from_xml_string(source.xml)
        is_tyre = model.geom_priority > 0
        model.body_invweight0[model.geom_bodyid[is_tyre], 0] = source.tyres.inverse_weight
        return model, mujoco.MjData(model)

    def _use(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self.coordinates, self.velocities = data.qpos, data.qvel
        self.applied, self.bias = data.qfrc_applied, data.qfrc_bias
        self.damping, self.dry_friction = model.dof_damping, model.dof_frictionloss
        self.shape_friction, self.shape_positions = model.geom_friction, data.geom_xpos
        self._rotations = data.xmat
        self._product: Array = np.empty(model.nv)

    def replace(self, model: WorldModel) -> None:
        """Go on with another model that has the same joints."""
        old = self._data
        self._use(*self._compile(model))
        self._data.qpos[:], self._data.qvel[:] = old.qpos, old.qvel
        self._data.qacc_warmstart[:] = old.qacc_warmstart
        self._data.qfrc_applied[:] = old.qfrc_applied
        self._data.mocap_pos[:] = old.mocap_pos
        self._data.time = old.time
        self.refresh()

    # names and indices

    def dof(self, joint: str) -> int:
        """Return the index of a joint's first velocity."""
        return int(self._model.joint(joint).dofadr[0])

    def coordinate(self, joint: str) -> int:
        """Return the index of a joint's first coordinate."""
        return int(self._model.joint(joint).qposadr[0])

    def body(self, name: str) -> int:
        """Return the index of a body."""
        return int(self._model.body(name).id)

    def tyres(self) -> tuple[Indices, Indices, Array]:
        """Return what rolls on the floor, one entry per tyre.

        Returns:
            Indices of the tyres' shapes, indices of the velocities of the hinges on which they
            roll freely, and their radii [m].
        """
        model = self._model
        shapes = np.nonzero(model.geom_priority > 0)[0].astype(np.int32)
        hinges = model.body_dofadr[model.geom_bodyid[shapes]].astype(np.int32)
        return shapes, hinges, model.geom_size[shapes, 0].copy()

    def parties(self) -> tuple[str, ...]:
        """Return the name of the body of each shape; a part without a name has its parent's."""
        model, names = self._model, []
        for k in range(model.ngeom):
            body = int(model.geom_bodyid[k])
            while body and not model.body(body).name:
                body = int(model.body_parentid[body])
            names.append(str(model.body(body).name) if body else FLOOR)
        return tuple(names)

    def shapes_below(self, body: str) -> NDArray[np.bool_]:
        """Return whether each shape belongs to a body or to one that is jointed to it."""
        model = self._model
        below: NDArray[np.bool_] = (
            model.body_rootid[model.geom_bodyid] == model.body_rootid[self.body(body)]
        )
        return below

    def corners(self, shapes: NDArray[np.intp]) -> Array:
        """Return the corners (8 k, 3) of the boxes around shapes, along the shapes' axes [m]."""
        model, data = self._model, self._data
        middles, halves = np.split(model.geom_aabb[shapes], 2, axis=1)
        local = middles[:, None, :] + halves[:, None, :] * SIGNS
        axes = data.geom_xmat[shapes].reshape(-1, 3, 3)
        places = local @ axes.transpose(0, 2, 1) + data.geom_xpos[shapes][:, None, :]
        corners: Array = places.reshape(-1, 3)
        return corners

    # state

    def pose(self, body: int) -> tuple[Array, Array]:
        """Return position (3,) [m] and rotation (3, 3) of a body in the world."""
        return self._data.xpos[body], self._data.xmat[body].reshape(3, 3)

    def heading(self, body: int) -> float:
        """Return the direction of a body's x axis on the floor, within pi of zero [rad]."""
        rotations = self._rotations
        return math.atan2(rotations.item(body, 3), rotations.item(body, 0))

    def place(self, body: int, x: float, y: float) -> None:
        """Place a body that nothing else moves, see `add_things`, at (x, y) in the world [m]."""
        self._data.mocap_pos[self._model.body_mocapid[body], :2] = x, y

    def inertial_forces(self, accelerations: Array) -> Array:
        """Return the forces and torques for accelerations of all joints, until the next call."""
        mujoco.mj_mulM(self._model, self._data, self._product, accelerations)
        return self._product

    def energies(self) -> tuple[float, float]:
        """Return potential and kinetic energy of all bodies [J]."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        potential, kinetic = self._data.energy
        return float(potential), float(kinetic)

    # steps

    def advance(self) -> None:
        """Apply forces and advance to the end of the step."""
        mujoco.mj_step2(self._model, self._data)

    def refresh(self) -> None:
        """Find positions, contacts and forces of inertia of the present state."""
        mujoco.mj_step1(self._model, self._data)

    # contacts; they have forces between `advance` and `refresh`

    def contacts(self) -> tuple[Indices, NDArray[np.int32]]:
        """Return the shapes (k, 2) that touch, and where their forces are in `forces`, (k,).

        Shapes that touch without any force have -1 there.
        """
        contact = self._data.contact
        return contact.geom, contact.efc_address

    @property
    def forces(self) -> Array:
        """Forces of all constraints: per contact normal, then along the two tangents [N]."""
        values: Array = self._data.efc_force
        return values

    @property
    def slips(self) -> Array:
        """Velocities at all constraints at the beginning of the step, as `forces` [m/s]."""
        values: Array = self._data.efc_vel
        return values

    @property
    def distances(self) -> Array:
        """Distances of the shapes that touch [m], (k,); negative where they overlap."""
        values: Array = self._data.contact.dist
        return values

    def contact_frame(self, k: int) -> tuple[Array, Array]:
        """Return where contact `k` is [m], (3,), and its axes (3, 3).

        The first axis points from the first shape to the second.
        """
        contact = self._data.contact
        return contact.pos[k], contact.frame[k].reshape(3, 3)

    def velocity(self, shape: int, place: Array) -> Array:
        """Return the velocity (3,) [m/s] of a point of a shape's body as the step begins.

        Args:
            place: The point in the world, (3,) [m].
        """
        body, motion = int(self._model.geom_bodyid[shape]), np.empty(6)
        mujoco.mj_objectVelocity(
            self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, body, motion, 0
        )
        velocity: Array = motion[3:] + np.cross(motion[:3], place - self._data.xpos[body])
        return velocity

    # rays

    def rays(
        self, origin: Array, directions: Array, longest: float, groups: Sequence[int]
    ) -> Array:
        """Return how far rays go until they meet a shape [m], (k,); -1 if they meet none.

        Args:
            origin: Common beginning of the rays in the world [m], (3,).
            directions: Unit vectors in the world, (k, 3).
            longest: Distance beyond which shapes are ignored [m].
            groups: Groups of the shapes that are met.
        """
        count = len(directions)
        seen = np.zeros(6, dtype=np.uint8)
        seen[list(groups)] = 1
        met, distances = np.empty(count, dtype=np.int32), np.empty(count)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            origin,
            np.ascontiguousarray(directions).ravel(),
            seen,
            True,
            -1,
            met,
            distances,
            None,
            count,
            longest,
        )
        return distances
