"""What a line of godwit_link_peer's poses file must be in ODOMETRY, by our own arithmetic."""
import math


def rotation(q):
    w, x, y, z = q
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def mul(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(len(b[0]))] for i in range(3)]


def column(v):
    return [[x] for x in v]


def transpose(a):
    return [list(r) for r in zip(*a)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


# The mounting and turn rate of godwit_link_peer.
C, D = math.cos(0.35), math.sin(0.35)
BODY_CAM = [[0, -D, C], [1, 0, 0], [0, C, D]]
ARM, RATES = [0.2, 0.05, -0.1], [0.1, -0.05, 0.2]
FRD = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]


def expected(line):
    """Position, rotation, body velocity in LOCAL_FRD / BODY_FRD from a line of the poses file, by our own arithmetic."""
    v = [float(x) for x in line[2:]]
    world_cam = rotation(v[3:7])
    world_body = mul(world_cam, transpose(BODY_CAM))
    arm_world = [-x[0] for x in mul(world_body, column(ARM))]  # from the camera to the body's origin
    position = [p + a for p, a in zip(v[0:3], arm_world)]
    rate_world = [x[0] for x in mul(world_cam, column(RATES))]
    velocity = [a + b for a, b in zip(v[7:10], cross(rate_world, arm_world))]
    local_body = mul(FRD, world_body)
    body_velocity = [x[0] for x in mul(transpose(world_body), column(velocity))]
    return [x[0] for x in mul(FRD, column(position))], local_body, body_velocity


def quality_of(m):
    """What docs/navigation.md makes of the variances of place, attitude and velocity."""
    mean = lambda values, places: sum(values[k] for k in places) / 3
    return 100 / (1 + mean(m.pose_covariance, (0, 6, 11)) / 3**2 + mean(m.pose_covariance, (15, 18, 20)) / math.radians(5)**2 +
                  mean(m.velocity_covariance, (0, 6, 11)) / 0.5**2)
