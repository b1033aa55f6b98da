"""Simulated axis of an ODrive that speaks CANSimple.

Written from public documents: "CAN Protocol" of the ODrive manual and its DBC file
`odrive-cansimple-0.6.10` (identifiers, layouts, error bits, states, results; firmware 0.6); the
examples of `odriverobotics/ODriveResources` (`can_simple.py`, `can_watchdog.py`); and the source
of firmware 0.5.6, the last that is public (`can_simple.cpp`, `axis.cpp`, `controller.cpp`), where
the documents leave the behaviour open.
"""
