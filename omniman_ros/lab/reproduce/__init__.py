"""The experiments of `omniman reproduce`, and the report that compares them with the papers."""
