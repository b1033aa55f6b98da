"""Path interpolation, CCTA 2017 V.B: from poses to a stream of x, x', x'' within limits.

In the order of the computation:

* `polyline`: the poses, cleaned of repeats and of detail that the tolerance does not ask for;
* `curve`: corners rounded by parabolas within the tolerance, continuous slope, bounded curvature;
* `time_profile`: the least time along the curve within speed and acceleration limits, exactly;
* `smoothing`: a moving average in time over 2 A / J, which bounds the jerk and keeps the rest;
* `planner`: all of it; `trajectory`: the result on the time base;
* `interpolator`: follow, pause, resume, cancel, slow down, replace;
* `control`: whether the stream is followed, and whether one may begin;
* `parameters`: what the platform's paths are set by;
* `joint_points`, `given_times`, `timed_curve`, `axis_limits`: trajectories of joints, with times
  that are kept and checked, or planned as above;
* `joint_interpolator`: follow, pause, resume, cancel, replace them; `joint_parameters`;
* `pace`: slows all of it on its paths together, and brings it back.

All work on any number of coordinates (`axes`), so that arm joints can share the time base.
"""
