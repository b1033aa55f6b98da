"""Build and installation of omniman_ros: under colcon, and with pip.

A new executable is one line in EXECUTABLES, a new folder of shared files one line in SHARED.

Three ways lead to an installation, and each puts the executables where its user looks for them:

* colcon: in lib/omniman_ros/, by setup.cfg, each with the interpreter that ran colcon;
* pip: in bin/, and for each a stub in lib/omniman_ros/, where `ros2 run` and `ros2 launch` look;
* pip, editable: in bin/ only. Such an installation has no data files: no stubs, no marker in the
  ament index, no share/. The package still finds its shared files, in the source tree (share.py).
"""

import re
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

from distutils.command.install_data import install_data  # isort: skip  (setuptools provides it)

NAME = "omniman_ros"
HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file

EXECUTABLES = {
    "omniman": "omniman_ros.cli.main:main",
    "platform_controller": "omniman_ros.nodes.platform_controller:main",
    "simulated_drive": "omniman_ros.nodes.simulated_drive:main",
    "simulated_world": "omniman_ros.nodes.simulated_world:main",
    "can_bridge": "omniman_ros.nodes.can_bridge:main",
    "simulated_can_drives": "omniman_ros.nodes.simulated_can_drives:main",
    "simulated_ur": "omniman_ros.nodes.simulated_ur:main",
    "arm_streamer": "omniman_ros.nodes.arm_streamer:main",
    "path_interpolator": "omniman_ros.nodes.path_interpolator.node:main",
    "mpc_planner": "omniman_ros.nodes.mpc_planner.node:main",
    "whole_body_planner": "omniman_ros.nodes.whole_body_planner.node:main",
    "joint_states_merger": "omniman_ros.nodes.joint_states_merger:main",
    "odometry": "omniman_ros.nodes.odometry:main",
    "station_keeper": "omniman_ros.nodes.station_keeper:main",
    "collision_monitor": "omniman_ros.nodes.collision_monitor:main",
    "obstacle_tracker": "omniman_ros.nodes.obstacle_tracker:main",
    "viewer": "omniman_ros.viewer.node:main",
}

# Folder below share/omniman_ros -> files that go there.
SHARED = {
    "": "package.xml",
    "config": "config/*.yaml",
    "config/can": "config/can/*.yaml",
    "config/ur": "config/ur/*.yaml",
    "config/worlds": "config/worlds/*.yaml",
    "launch": "config/launch/*.py",
    "config/nav2": "config/nav2/*.yaml",
    "config/robot_localization": "config/robot_localization/*.yaml",
    "config/sros2": "config/sros2/*.xml",
    "rviz": "config/rviz/*",
    "plotjuggler": "config/plotjuggler/*",
}

STUB = """\
#!/bin/sh
# Where `ros2 run` and `ros2 launch` look for {name}; it runs the one that pip installed in bin/.
exec "$(dirname "$(readlink -f "$0")")/../../bin/{name}" "$@"
"""


class InstallDataAndStubs(install_data):
    """Installs the data files, and in a wheel also the stubs.

    colcon installs its own executables in lib/omniman_ros/ and builds no wheel.
    """

    def run(self) -> None:
        """Install the files; all that is installed ends up in `self.outfiles`."""
        super().run()
        if not self.distribution.get_command_obj("bdist_wheel", create=False):
            return
        folder = Path(self.install_dir, "lib", NAME)
        folder.mkdir(parents=True, exist_ok=True)
        for name in EXECUTABLES:
            stub = folder / name
            stub.write_text(STUB.format(name=name))
            stub.chmod(0o755)
            self.outfiles.append(str(stub))


def version() -> str:
    """Version of the package, which package.xml has: tools of ROS raise it there."""
    (text,) = re.findall("<version>(.*)</version>", (HERE / "package.xml").read_text())
    return str(text)


def data_files() -> list[tuple[str, list[str]]]:
    """Pairs of a folder of the installation and the files that go there."""
    marker = ("share/ament_index/resource_index/packages", [f"resource/{NAME}"])
    shared = [
        (str(Path("share", NAME, folder)), sorted(glob(pattern)))
        for folder, pattern in SHARED.items()
    ]
    return [marker] + [(folder, files) for folder, files in shared if files]


setup(
    name=NAME,
    version=version(),
    description="Motion control of a mobile manipulator on Mecanum or Omni wheels",
    long_description=(HERE / "README.md").read_text(),
    long_description_content_type="text/markdown",
    maintainer="omniman_ros developers",
    maintainer_email="omniman_ros@example.org",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=data_files(),
    entry_points={"console_scripts": [f"{name} = {main}" for name, main in EXECUTABLES.items()]},
    cmdclass={"install_data": InstallDataAndStubs},
    zip_safe=True,
    python_requires=">=3.11",
    # rclpy and the messages stay out: a ROS machine has its own. lark-parser is the name under
    # which ROS's wheels ask for the parser generator: "lark" would overwrite its files.
    install_requires=[
        "argcomplete",
        "canopen",
        "casadi",
        "lark-parser",
        "msgpack",
        "numpy",
        "python-can",
        "PyYAML",
        "scipy",
    ],
    extras_require={
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        # A linter's next version finds other things: its version is ours to raise.
        "test": [
            "catkin_pkg",
            "hypothesis",
            # The arrows between the rooms are a contract in pyproject.toml.
            "import-linter>=2.13,<3",
            "mcap",
            "mypy==2.4.*",
            "odrive-can",
            "pytest",
            "pytest-xdist",
            "rosbags",
            "ruff==0.17.*",
            "setuptools",
            "types-PyYAML",
            "ur-rtde",
        ],
        # A robot that records needs no pictures.
        "record": ["rosbags"],
        "plot": ["matplotlib", "pillow", "rosbags"],
        # The page relies on how viser marks up its buttons.
        "viewer": ["viser==1.1.*", "websockets"],
        # Sweeps of the laboratory on more than one machine.
        "cluster": ["distributed"],
        # 4.0.0 factorises sparse matrices wrongly; a next major version may change the physics.
        "world": ["mujoco-core==4.*,>=4.0.1"],
        "browser": ["playwright"],
        "docs": ["furo", "myst-parser", "sphinx", "sphinx-copybutton"],
        "reference": ["pin"],
        "colcon": ["colcon-common-extensions"],
    },
)
