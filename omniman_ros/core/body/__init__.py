"""Platform and arm as one robot of nine axes: its kinematics, and Cartesian paths of its tool."""
