"""Real motor drives on a CAN bus: the policy of the bridge and one codec per drive protocol."""
