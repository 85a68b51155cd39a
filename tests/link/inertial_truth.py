"""What an autopilot fused against where the aircraft was: the truth at any time, and how far the messages are from it."""
import math
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import numpy as np  # noqa: E402
from replay_link_test import FRD, rotation  # noqa: E402


def turned(yaw):
    return np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])


def heading(R):
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])


class Truth:
    """The body in the world, z up: place, attitude and speed at any time of the recording."""

    def __init__(self, file):
        rows = np.array([[float(x) for x in line.split()] for line in open(file) if line[0] != "#"])
        self.t, self.p, self.q = rows[:, 0], rows[:, 1:4], rows[:, 4:8]

    def at(self, t):
        i = int(np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1))
        x = (t - self.t[i - 1]) / (self.t[i] - self.t[i - 1])
        q = (1 - x) * self.q[i - 1] + x * self.q[i] * np.sign(self.q[i] @ self.q[i - 1])
        v = (self.p[i] - self.p[i - 1]) / (self.t[i] - self.t[i - 1])
        return (1 - x) * self.p[i - 1] + x * self.p[i], rotation(*(q / np.linalg.norm(q))), v

    def path(self, t0, t1):
        inside = self.p[(self.t >= t0) & (self.t <= t1)]
        return np.linalg.norm(np.diff(inside, axis=0), axis=1).sum()


def clock_offset(samples, stamps):
    """What is between the recording's microseconds and the messages': the constant that most agree on."""
    votes = {}
    for _, m in samples[:60]:
        for s in stamps[:300]:
            votes[(m.time_usec - s) // 4] = votes.get((m.time_usec - s) // 4, 0) + 1
    return max(votes, key=votes.get) * 4 + 2


class Fused:
    """What the autopilot fused, in the truth's frame: heading and place agree with the first."""

    def __init__(self, samples, offset, truth):
        self.t = np.array([(m.time_usec - offset) * 1e-6 for m in samples])
        at = [truth.at(t) for t in self.t]
        R = [FRD @ rotation(m.q[1], m.q[2], m.q[3], m.q[0]) for m in samples]
        p = np.array([FRD @ [m.x, m.y, m.z] for m in samples])
        G = turned(heading(at[0][1] @ R[0].T))
        self.error = np.array([a[0] for a in at]) - (at[0][0] + (p - p[0]) @ G.T)
        self.place = at[0][0] + (p - p[0]) @ G.T
        self.true_place = np.array([a[0] for a in at])
        up = np.array([0, 0, 1.0])
        self.tilt = np.array([np.degrees(math.acos(min(1.0, (r.T @ up) @ (a[1].T @ up)))) for r, a in zip(R, at)])
        self.turn = np.degrees([heading(a[1] @ (G @ r).T) for r, a in zip(R, at)])
        self.speed_error = np.array([a[2] - G @ r @ [m.vx, m.vy, m.vz] for r, a, m in zip(R, at, samples)])
        self.sigma = np.array([math.sqrt(m.pose_covariance[0] + m.pose_covariance[6] + m.pose_covariance[11]) for m in samples])
        self.quality = np.array([m.quality for m in samples])

    def during(self, t0, t1):
        return (self.t >= t0) & (self.t < t1)


def by_speed(samples, offset, period, truth):
    """Pictures come evenly, and the first ones may not have been sent: by how many `offset` is wrong, the speed tells."""
    flights = [Fused(samples, offset + k * period, truth) for k in range(-8, 9)]
    return min(flights, key=lambda flight: (flight.speed_error ** 2).sum())


def scale_and_ate(place, truth):
    """Of the best similarity that turns about the vertical alone (translation and heading free): scale, and RMS without
    it."""
    a, b = place - place.mean(axis=0), truth - truth.mean(axis=0)
    yaw = math.atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    turned_a = a @ turned(yaw).T
    scale = (turned_a * b).sum() / (b * b).sum()
    return scale, math.sqrt(((b - turned_a) ** 2).sum(axis=1).mean())


def offset_by_speed(samples, first_stamp, truth):
    """What is between the truth's microseconds and the messages', by when how fast it flew: a grid of readings looks the
    same from each of its lines. Whole steps of 5 ms from the first message at the first picture."""
    t = np.array([m.time_usec for m in samples]) * 1e-6
    told = np.array([math.sqrt(m.vx ** 2 + m.vy ** 2 + m.vz ** 2) for m in samples])
    fast = np.linalg.norm(np.diff(truth.p, axis=0), axis=1) / np.diff(truth.t)
    middle = (truth.t[1:] + truth.t[:-1]) / 2
    at_first = t[0] - first_stamp * 1e-6
    shifts = at_first - np.arange(-0.2, 4.0, 0.005)
    off = [((np.interp(t - s, middle, fast) - told) ** 2).mean() for s in shifts]
    return shifts[int(np.argmin(off))] * 1e6
