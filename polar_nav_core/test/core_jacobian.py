"""A state with every block in use, and numeric Jacobians over the filter's retraction."""

import numpy as np
from core_places import position
from reference.error_model import Navigation

from polar_nav_core import attitude
from polar_nav_core.error_model import X

LEVER = np.array([-0.8, 0.1, 0.6])


def navigation_at(name):
    return Navigation(
        C_b_G=attitude.matrix_from_euler(2.0, 0.1, -0.2),
        v_G=np.array([2.0, -3.0, 0.1]),
        r_e=position(name),
        b_gyro_b=np.array([1e-3, -2e-3, 5e-4]),
        dvl_scale_m=np.array([0.01, -0.02, 0.005]),
        dvl_markov_m=np.array([0.02, 0.01, -0.03]),
        usbl_bias_a=np.array([0.5, -0.3, 0.2]),
    )


def numeric_jacobian(innovation, navigation):
    """H of innovation(estimate) - innovation(corrected) = H x, by central differences."""
    columns = []
    steps = np.repeat([3e-4, 1e-2, 10.0, 1e-4, 1e-3, 1e-4, 1e-3, 0.1], 3)
    for i, step in enumerate(steps):
        x = np.zeros(X.size)
        x[i] = step
        columns.append(
            (innovation(navigation.corrected(-x)) - innovation(navigation.corrected(x)))
            / (2 * step)
        )
    return np.column_stack(columns)
