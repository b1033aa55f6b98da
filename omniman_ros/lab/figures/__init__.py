"""Pictures of the reproduced experiments, drawn with matplotlib."""
