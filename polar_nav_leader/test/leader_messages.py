"""Messages as a leader's sensors would send them, from the core's helper world."""

import numpy as np
from sensor_msgs.msg import Imu, NavSatFix

from polar_nav_core import earth
from polar_nav_msgs.msg import Depth, Dvl, UsblFix
from polar_nav_ros.stamps import to_msg

SOUND = 1440.0
TURN_AROUND = 0.05


def imu(sample):
    msg = Imu()
    msg.header.stamp = to_msg(sample.stamp_ns)
    w, f = msg.angular_velocity, msg.linear_acceleration
    w.x, w.y, w.z = sample.omega_ib_b.tolist()
    f.x, f.y, f.z = sample.f_b.tolist()
    return msg


def dvl(ping):
    msg = Dvl(velocity_mode=Dvl.DVL_MODE_BOTTOM, num_good_beams=4)
    msg.header.stamp = to_msg(ping.stamp_ns)
    msg.velocity.x, msg.velocity.y, msg.velocity.z = ping.v_m.tolist()
    msg.velocity_covar = ping.covariance_m.reshape(9)
    return msg


def depth(sample):
    msg = Depth(depth=sample.depth, variance=sample.variance)
    msg.header.stamp = to_msg(sample.stamp_ns)
    return msg


def absolute(stamp_ns, r_e, covariance_g, kind=NavSatFix.COVARIANCE_TYPE_KNOWN):
    lat, lon, height = (float(x) for x in earth.geodetic_from_ecef(r_e))
    msg = NavSatFix(latitude=np.degrees(lat), longitude=np.degrees(lon), altitude=height)
    msg.header.stamp = to_msg(stamp_ns)
    msg.position_covariance = np.asarray(covariance_g, dtype=float).reshape(9)
    msg.position_covariance_type = kind
    return msg


def usbl(return_ns, sequence=0, distance=500.0):
    round_trip = TURN_AROUND + 2 * distance / SOUND
    msg = UsblFix(source='leader', target='follower', sequence=sequence)
    msg.header.stamp = to_msg(return_ns - round(distance / SOUND * 1e9))
    msg.ping_time = to_msg(return_ns - round(round_trip * 1e9))
    msg.return_time = to_msg(return_ns)
    msg.turn_around, msg.round_trip = TURN_AROUND, round_trip
    msg.range, msg.range_variance = distance, 0.09
    msg.direction.x, msg.direction.y, msg.direction.z = 0.8, 0.0, -0.6
    msg.direction_cosine_covariance = [1e-6, 0.0, 0.0, 1e-6]
    msg.sound_speed = SOUND
    msg.target_depth = msg.target_depth_variance = float('nan')
    return msg


def stream(world, until_s):
    """(topic, message) of IMU, DVL and depth in the order of their stamps."""
    events = [
        *((e.key, 'imu/data_raw', imu(e)) for e in world.imu()),
        *((e.key, 'dvl/data', dvl(e)) for e in world.dvl()),
        *((e.key, 'depth/data', depth(e)) for e in world.depth()),
    ]
    end_ns = int(world.stamps[0]) + round(until_s * 1e9)
    for key, topic, message in sorted(events, key=lambda e: e[0]):
        if key[0] <= end_ns:
            yield topic, message
