# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""SIMBICON, a hand-crafted walking controller (Yin, Loken and van de Panne, 2007).

A step has two states, and the step of the other leg is its mirror image. Each state has a target
for each joint, which PD control tracks. The torso's and the swing thigh's angles are held in the
world's frame, and the stance hip bears both: τ_stance = −τ_torso − τ_swing. Balance feedback moves
the swing thigh's target with the distance d from stance ankle to hips and the hips' velocity v:

    θ = θ_0 + c_d d + c_v v.

State 0 lasts a fixed time. State 1 ends when the swing foot bears a load, or after a time limit.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.dynamics import Dynamics

# Coordinates of the walker's positions; velocities are in the same order.
PITCH, LEFT, RIGHT = 2, slice(3, 6), slice(6, 9)  # each leg has hip, knee and ankle
SEGMENT = 0.45  # length of thigh and shin [m]
STIFFNESS = np.array([300.0, 300.0, 100.0])  # hip, knee, ankle [N·m/rad]
DAMPING = np.array([30.0, 30.0, 4.0])  # [N·m·s/rad]
TORQUE_LIMIT = 250.0  # [N·m]
TOUCHDOWN_LOAD = 50.0  # on the swing foot [N]
SHORTEST_SWING = 0.05  # time in state 1 before a load may end it [s]
LONGEST_SWING = 0.6  # time after which state 1 ends without a load [s]


@dataclass(frozen=True)
class Pose:
    """Targets of one state [rad].

    Attributes:
        swing_thigh: θ_0, forwards from the vertical.
        swing_knee: negative where the knee is bent.
        swing_ankle: positive where the toes point up.
        stance_knee: like swing_knee.
        stance_ankle: like swing_ankle.
        distance_gain: c_d [rad/m].
        velocity_gain: c_v [rad·s/m].
    """

    swing_thigh: float
    swing_knee: float
    swing_ankle: float
    stance_knee: float
    stance_ankle: float
    distance_gain: float
    velocity_gain: float


@dataclass(frozen=True)
class Gait:
    """The parameters, which `benchmarks/find_gait.py` has searched for.

    Attributes:
        duration: duration of state 0 [s].
        torso: target of the torso's pitch [rad].
        torso_stiffness: stiffness of the torso [N·m/rad]; its damping is a tenth of it.
        poses: poses of the two states.
    """

    duration: float
    torso: float
    torso_stiffness: float
    poses: tuple[Pose, Pose]


GAIT = Gait(
    duration=0.306,
    torso=0.097,
    torso_stiffness=560.0,
    poses=(
        Pose(0.305, -0.788, 0.217, -0.012, 0.219, 0.909, 0.224),
        Pose(0.102, -0.295, 0.263, -0.393, 0.142, -0.303, 0.430),
    ),
)


class Simbicon:
    """A state machine that turns states of the walker into torques, once a time step [s]."""

    def __init__(self, gait: Gait, time_step: float):
        self.gait = gait
        self._time_step = time_step
        self._state, self._elapsed = 0, 0.0
        self._swing, self._stance = LEFT, RIGHT

    def torques(self, state: Array, loads: Array) -> Array:
        """Returns the torques for one step, and advances the state machine by it.

        Args:
            state: x, shape (18,).
            loads: forces on the left and the right foot, shape (2,), [N].

        Returns:
            Shape (6,), left leg first, [N·m].
        """
        self._transition(loads[0 if self._swing == LEFT else 1])
        q, v = state[:9], state[9:]
        gait, pose = self.gait, self.gait.poses[self._state]
        stance_hip, stance_knee, _ = q[self._stance]
        pitch, pitch_rate = q[PITCH], v[PITCH]

        # d is positive if the hips are in front of the ankle; a forward lean has a negative angle.
        thigh = stance_hip - pitch
        d = -SEGMENT * (np.sin(thigh) + np.sin(thigh + stance_knee))
        thigh_target = pose.swing_thigh + pose.distance_gain * d + pose.velocity_gain * v[0]
        swing = np.array([thigh_target + pitch, pose.swing_knee, pose.swing_ankle])
        stance = np.array([stance_hip, pose.stance_knee, pose.stance_ankle])
        torque = np.empty(9)
        for leg, target in ((self._swing, swing), (self._stance, stance)):
            torque[leg] = STIFFNESS * (target - q[leg]) - DAMPING * v[leg]
        # The swing thigh is damped by its rate in the world's frame.
        torque[self._swing][0] += DAMPING[0] * pitch_rate
        torso = gait.torso_stiffness * (gait.torso - pitch - 0.1 * pitch_rate)
        # A torque that flexes a hip turns the torso forwards: τ_torso = τ_stance + τ_swing.
        torque[self._stance][0] = torso - torque[self._swing][0]
        self._elapsed += self._time_step
        return np.clip(torque[3:], -TORQUE_LIMIT, TORQUE_LIMIT)

    def _transition(self, load: float) -> None:
        """Changes the state when the swing foot bears a load, or its time is over."""
        if self._state == 0:
            if self._elapsed >= self.gait.duration:
                self._state, self._elapsed = 1, 0.0
        elif self._elapsed >= LONGEST_SWING or (
            self._elapsed >= SHORTEST_SWING and load > TOUCHDOWN_LOAD
        ):
            self._state, self._elapsed = 0, 0.0
            self._swing, self._stance = self._stance, self._swing


class FootLoads:
    """Computes the forces that the floor exerts on each foot while no motor acts."""

    def __init__(self, model: mujoco.MjModel):
        self._model, self._data = model, mujoco.MjData(model)
        self._feet = [model.geom(name).id for name in ("left_foot", "right_foot")]

    def __call__(self, state: Array) -> Array:
        """Returns the forces on the left and the right foot in a state, shape (2,), [N]."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = np.split(state, 2)
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(model, data)
        loads, wrench = np.zeros(2), np.zeros(6)
        for i, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, i, wrench)
            loads[self._feet.index(max(contact.geom))] += wrench[0]
        return loads


def walk(dynamics: Dynamics, gait: Gait, steps: int) -> Trajectory:
    """Walks T = `steps` from a stand; the trajectory is NaN from where it diverges on."""
    return go_on(dynamics, Simbicon(gait, dynamics.time_step), standing(), steps)


def go_on(dynamics: Dynamics, controller: Simbicon, start: Array, steps: int) -> Trajectory:
    """Returns walking from a state, in the phase of the gait that the controller is in."""
    loads = FootLoads(dynamics.model)

    def control_law(_: int, x: Array) -> Array:
        return controller.torques(x[0], loads(x[0]))[None]

    return dynamics.rollout(start, control_law, steps)


def standing() -> Array:
    """Returns the state of a stand with slightly bent knees, shape (18,)."""
    state = np.zeros(18)
    state[1] = 0.925
    state[LEFT] = state[RIGHT] = 0.1, -0.2, 0.1
    return state
