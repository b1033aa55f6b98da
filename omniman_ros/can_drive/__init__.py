"""Motor drives on a CAN bus: protocols and policy, pure; python-can only in `bus`."""
