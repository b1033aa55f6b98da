"""Link to a UR controller: setpoints every 8 ms, feedback, and the program that runs on it."""
