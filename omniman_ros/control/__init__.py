"""Control of the platform: odometry, kinematics, dynamics and the controllers of CCTA 2017."""
