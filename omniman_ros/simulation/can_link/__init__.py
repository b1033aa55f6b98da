"""The bus of simulated drives in simulated time: a stream of frames and of instants."""
