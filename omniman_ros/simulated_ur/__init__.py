"""A simulated UR controller: its own protocols, program runner, servo and safety."""
