"""The command `omniman`: one module a subcommand, and what they share."""
