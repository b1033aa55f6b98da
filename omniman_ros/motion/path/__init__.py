"""Path interpolation, CCTA 2017 V.B: from poses to a stream of x, x', x'' within limits.

In the order of the computation:

* `polyline`: the poses without repeats and without detail finer than the tolerance;
* `curve`: corners rounded by parabolas within the tolerance, continuous slope, bounded curvature;
* `time_profile`: the minimum time along the curve within speed and acceleration limits;
* `smoothing`: a moving average in time over 2 A / J, which bounds the jerk and keeps the other
  limits;
* `planner`: all of these steps; `trajectory`: their result on the time base;
* `interpolator`: follow, pause, resume, cancel, slow down, replace;
* `parameters`: the parameters of the platform's paths;
* `joint_points`, `spline_derivatives`, `timed_curve`, `axis_limits`: trajectories of joints, with
  given times, which are kept and checked, or planned as above;
* `moving_target`: streams of single points;
* `joint_interpolator`: follow, pause, resume, cancel, replace trajectories of joints;
  `joint_parameters`: their parameters; `trajectory_goal`: tolerances of their action goals;
* `pace`: slows all motions down together on their paths, and back up again; stretches of the
  resulting streams.

All modules work on any number of coordinates (`axis_group`), so that arm joints can share the
time base.
"""
