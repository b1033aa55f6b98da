"""The type of the arrays that the cores compute with."""

import numpy as np
from numpy.typing import NDArray

#: An array of 64-bit floats; docstrings give its shape, units and frame
Array = NDArray[np.float64]
