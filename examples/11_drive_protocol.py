r"""A drive protocol of your own.

A `DriveAxis` turns demands into frames and reports into feedback, at the motor's shaft; who drives
and who stops is the bridge's policy. Here a drive is unplugged at 1.5 s (light): the others stop.
"""

import struct

import numpy as np
from matplotlib import pyplot

import omniman_ros as om
from picture import DARK, LIGHT, finish


class PlainAxis(om.DriveAxis):  # for the node can_bridge: `can.protocol: my_module:PlainAxis`
    def __init__(self, settings):
        super().__init__(settings, [0x100 + settings.node], {0x180 + settings.node: self.report})

    def report(self, data, now):
        angle, speed, power = struct.unpack("<fe?", data)  # [rad], [rad/s]
        self.feedback.measure(angle, speed, now)
        self.state = om.AxisState.ENABLED if power else om.AxisState.READY

    def frames(self, demand, setpoint, now):
        data = struct.pack("<f?", setpoint.value, self.wants_power(demand))
        return [om.CanFrame(0x100 + self.settings.node, data)]


def main() -> dict[str, float]:
    can = om.CanParameters(protocol=f"{__name__}:PlainAxis", nodes=(1, 2, 3, 4))
    policy, times = om.CanDrives(om.load_robot("omniman").platform, can), np.arange(500) / can.rate
    wheels, angle, speeds = np.array([4.0, 3.0, 2.0, -1.0]), np.zeros(4), np.zeros((500, 4))
    policy.configure(now=0.0)
    for i, now in enumerate(times):
        if now == 0.5:
            policy.enable(now)
        policy.set_command(om.WheelCommand(om.DriveMode.VELOCITY, 0 * wheels, wheels), now)
        for k, frame in enumerate(policy.tick(now)[: 4 if now < 1.5 else 3]):
            speeds[i, k], power = struct.unpack("<f?", frame.data)  # a drive that follows exactly
            angle[k] += speeds[i, k] / can.rate
            data = struct.pack("<fe?", angle[k], speeds[i, k], power)
            policy.receive(om.CanFrame(0x181 + k, data), now)
    axes = pyplot.subplot(title=policy.stop_reason, xlabel="time [s]", ylabel="motors [rad/s]")
    axes.plot(times, speeds[:, :3], DARK, times[:300], speeds[:300, 3], LIGHT)
    return {"at_rest": times[speeds[:, 0] > 0.0].max() - 1.5}


if __name__ == "__main__":
    finish(main())
