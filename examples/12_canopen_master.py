r"""Simulated drives under a CANopen master of your own.

The library canopen switches a simulated CiA 402 drive on (controlwords 6, 7, 15), commands a speed
(light), reads speed (dark) and position, and stops it quickly (2). Time passes with each frame. On
a bus, in real time, the same drives are `ros2 run omniman_ros simulated_can_drives`.
"""

import can
import canopen
import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, LIGHT, finish


class SimulatedNetwork(canopen.Network):
    now, drives = 0.0, None  # [s]

    def send_message(self, can_id, data, remote=False):
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        self.wait(0.001, self.drives.receive(message, self.now))

    def wait(self, seconds, frames=()):
        self.now += seconds
        for frame in [*frames, *self.drives.advance(self.now)]:
            self.notify(frame.arbitration_id, bytearray(frame.data), self.now)


def main() -> dict[str, float]:
    robot = om.load_robot("omniman").changed({"plant.lifted": True})  # wheels off the floor
    can_bus = om.CanParameters(nodes=(1, 2, 3, 4), counts=4096)  # per revolution of a motor
    network, rows = SimulatedNetwork(), []
    network.drives = om.SimulatedBus(robot.platform, robot.simulation, can_bus)
    node = network.add_node(1, network.drives.drives["front_left"].object_dictionary)
    node.nmt.state = "RESET"
    network.wait(0.1)  # it boots
    node.nmt.state, node.sdo["Modes of operation"].raw = "OPERATIONAL", 3
    for word, target in [(6, 0)] * 20 + [(7, 0)] * 20 + [(15, 20)] * 100 + [(2, 0)] * 60:
        node.sdo["Target velocity"].raw, node.sdo["Controlword"].raw = target * 4096, word
        network.wait(0.01)
        rows.append([network.now, target, node.sdo["Velocity actual value"].raw / 4096])
    time, target, speed = np.transpose(rows)
    axes = pyplot.subplot(xlabel="time [s]", ylabel="speed of the motor [rev/s]")
    axes.plot(time, target, LIGHT, time, speed, DARK)
    return {"fastest": speed.max(), "turns": node.sdo["Position actual value"].raw / 4096}


if __name__ == "__main__":
    finish(main())
