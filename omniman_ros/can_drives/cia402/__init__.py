"""The CiA 402 drive profile over CANopen."""
