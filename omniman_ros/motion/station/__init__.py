"""Station keeping: one robot keeps its place relative to another one that moves.

* `leader`: motion of the leader, predicted from its odometry, and that of a station beside it;
* `approach`: how fast, and which way around the leader;
* `keeper`: meets the station, keeps it and leaves it, within the limits of the own robot;
* `parameters`: limits and options.
"""
