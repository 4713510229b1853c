"""The paper's equations and a flip's geometry, written out slowly in NumPy."""

from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation

FINE = 4000


def dock_pair_force(offset, attraction_gain, repulsion_gain, spacing, ramp):
    """Eq. (1), with `offset` from the robot's own dock to the other one."""
    distance = np.sqrt(sum(component**2 for component in offset))
    direction = np.array(offset) / distance
    if distance > spacing:
        return attraction_gain * ramp * (distance - spacing) * direction
    return -repulsion_gain * (1.0 - ramp) * (distance - spacing) ** 4 * direction


def matrix(wxyz):
    """Rotation matrix of a unit quaternion, from the textbook."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def localize(log, params):
    """Algorithm 1, line by line as the paper lists it; everything in units of the dock radius.

    Beside the listing: the ramp and the capped step, robots without located neighbors, and rounds
    of back-propagation.

    Returns:
        Positions, and the number of steps of each robot.
    """
    turn = [matrix(q) for q in log.orientation_wxyz]
    dock = [[r @ b for b in log.dock_offset_body] for r in turn]
    connected = {tuple(row) for row in log.contacts}
    connected |= {(j, b, i, a) for i, a, j, b in connected}
    place = {0: np.array(log.anchor_position)}
    steps = np.zeros(log.robot_count, int)
    rounds = params.back_propagation
    for r in range(1, log.robot_count):  # foreach new robot r joining the structure
        own_z = np.array([0, 0, 1.0]) if params.initial_offset_axis == "world" else turn[r][:, 2]
        around = [n for n in place if touches(connected, r, n)] or [0]
        place[r] = np.mean([place[n] for n in around], axis=0) + params.initial_offset * own_z
        for t in range(1, params.iterations + 1):  # repeat
            force = dock_forces(params, connected, place, dock, r, t / params.iterations)
            update(log, params, place, dock, r, force)
            steps[r] = t
            if misfit(log, params, connected, place, dock, r) < params.stop_error:
                break
        if rounds and (r + 1 == log.robot_count or (r + 1) % rounds.every == 0):
            recent = list(place)[-rounds.recent :] if rounds.recent else list(place)
            for t in range(1, rounds.sweeps + 1):
                ramp = 1 - rounds.repulsion_share * (1 - t / rounds.sweeps)
                for i in recent:
                    force = dock_forces(params, connected, place, dock, i, ramp, taut=True)
                    update(log, params, place, dock, i, force, rounds.gain)
                    steps[i] += i > 0
    return np.array(list(place.values())), steps


def touches(connected, r, n):
    """Whether any dock of robot r is connected to any of robot n."""
    return any((r, a, n, b) in connected for a in range(3) for b in range(3))


def dock_forces(params, connected, place, dock, r, ramp, *, taut=False):
    """Force on robot r: foreach neighbor, foreach dock pair.

    In rounds of back-propagation contacts are taut: docks that are too near part as firmly as
    attraction pulls.
    """
    force = np.zeros(3)
    for n in place:
        if n == r:
            continue
        for a in range(3):
            for b in range(3):
                offset = place[n] + dock[n][b] - place[r] - dock[r][a]
                distance = np.linalg.norm(offset)
                push = np.zeros(3)
                if (r, a, n, b) in connected:  # if docks are connected
                    push = dock_pair_force(
                        offset, params.attraction_gain, params.repulsion_gain, 2.0, ramp
                    )
                    if taut and distance < 2.0:
                        push += params.attraction_gain * ramp * (distance - 2.0) * offset / distance
                elif distance < 2.0 and (
                    params.undocked_repulsion
                    or (params.neighbor_repulsion and touches(connected, r, n))
                ):
                    push = dock_pair_force(offset, 0.0, params.repulsion_gain, 2.0, ramp)
                force += push
    return force


def update(log, params, place, dock, r, force, share=1.0):
    """Update P_r by the cumulative forces, and then by the height; the anchor stays."""
    height = known_height(log, params, dock, r)
    missing = 0.0 if np.isnan(height) else params.height_gain * (height - place[r][2])
    if params.height_order == "with-docks":
        force = force + np.array([0, 0, missing])
    step = share * force
    if np.linalg.norm(step) > params.max_step:
        step *= params.max_step / np.linalg.norm(step)
    if r > 0:
        place[r] = place[r] + step
    if r > 0 and params.height_order == "after-docks" and not np.isnan(height):
        place[r] = place[r] + [0, 0, share * params.height_gain * (height - place[r][2])]


def known_height(log, params, dock, r):
    """Height of a robot's center: by docks on the ground, else by its flips; NaN if unknown."""
    standing = [a for robot, a in log.ground_docks if robot == r]
    if params.ground and standing:
        return np.mean([log.ground_z + 1.0 - dock[r][a][2] for a in standing])
    return log.flip_height[r] if params.z_correction else np.nan


def misfit(log, params, connected, place, dock, r):
    """Root mean square by which contacts with earlier robots miss D, and the center its height."""
    missed = [
        np.linalg.norm(place[n] + dock[n][b] - place[r] - dock[r][a]) - 2.0
        for mine, a, n, b in connected
        if mine == r and n < r
    ]
    height = known_height(log, params, dock, r)
    missed += [] if np.isnan(height) else [height - place[r][2]]
    return np.sqrt(np.mean(np.square(missed)))


def turned(vector, axis, angle):
    """Rodrigues' rotation formula, for one angle or an array of them."""
    angle = np.asarray(angle)[..., None]
    along = axis * np.dot(axis, vector)
    return (vector - along) * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + along


def first_meeting(arm, axis, obstacle, spacing):
    """Angle in steps of a fine circle at which a turning dock first comes within `spacing`."""
    angles = np.linspace(0.0, 2.0 * np.pi, FINE, endpoint=False)
    inside = np.linalg.norm(turned(arm, axis, angles) - obstacle, axis=1) < spacing
    entering = np.flatnonzero(inside & ~np.roll(inside, 1))
    return angles[entering[0]] if len(entering) else np.inf


def closest_approach(arm, axis, obstacle):
    """Least distance between an obstacle and the circle of a turning dock."""
    angles = np.linspace(0.0, 2.0 * np.pi, FINE)
    return np.linalg.norm(turned(arm, axis, angles) - obstacle, axis=1).min()


def swarm_step(
    position,
    arm,
    contacts,
    structure,
    height,
    *,
    attraction_gain,
    repulsion_gain,
    height_gain,
    spacing,
    ramp,
    max_step,
    parting_gain=0.0,
    mobility=1.0,
    carried=0.0,
):
    """One step of all robots under Eqs. (1)-(3), dock pair by dock pair.

    In a guided swarm connected docks part, and a step carries on by a part of the last one.
    """
    rows = {tuple(row) for row in contacts} | {(j, m, i, k) for i, k, j, m in contacts}
    docks = range(arm.shape[1])
    force = np.zeros_like(position)
    for i, j in zip(*np.nonzero(structure[:, None] == structure), strict=True):
        for k, m in ((k, m) for k in docks for m in docks if i != j):
            offset = position[j] + arm[j, m] - position[i] - arm[i, k]
            if np.linalg.norm(offset) < spacing or (i, k, j, m) in rows:
                force[i] += dock_pair_force(offset, attraction_gain, repulsion_gain, spacing, ramp)
            if (i, k, j, m) in rows:
                distance = np.linalg.norm(offset)
                overlap = min(distance - spacing, 0.0)
                force[i] += parting_gain * ramp * overlap * offset / distance
    known = ~np.isnan(height)
    force[known, 2] += height_gain * (height - position[:, 2])[known]
    force = mobility * force + carried
    length = np.linalg.norm(force, axis=1)
    too_long = np.inf if max_step is None else max_step
    return position + force * np.minimum(1.0, too_long / np.maximum(length, 1e-300))[:, None]


def joint_force(log, known, position, yaw, tolerance, width, stretch, size=2.0):
    """Force and torque of the joint annealer on every robot: contacts, overlaps, known places.

    Docks overlap that are nearer than `size`.
    """
    turn = [Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() for angle in yaw]
    arm = [[r @ matrix(q) @ b / log.dock_radius for b in log.dock_offset_body]
           for r, q in zip(turn, log.orientation_wxyz, strict=True)]  # fmt: skip
    force, torque = np.zeros_like(position), np.zeros(len(position))
    contacts = Counter([*log.contacts[:, [0, 2]].ravel(), *log.touches[:, [0, 2]].ravel()])
    touching = Counter(map(tuple, log.contacts.tolist()))
    distance = ~known.is_offset
    for (i, j, own, its, apart, docks), variance, is_final, measured in zip(
        _distances(known, position, turn), known.variance[: distance.sum()],
        known.is_final[distance], known.rows.distances.length, strict=True,
    ):  # fmt: skip
        touching[docks] += is_final
        gap = np.linalg.norm(apart) - measured
        within = tolerance**2 + variance
        stiff = tolerance**2 / within / (1.0 + (gap / width) ** 2 / within)
        slope = gap if gap > 0.0 else _slope_inside(gap + measured, measured)
        pull = -stiff * slope * apart / np.linalg.norm(apart)
        force[i] += pull
        force[j] -= pull
        torque[i] += np.cross(own, pull)[2]
        torque[j] -= np.cross(its, pull)[2]
        if is_final:
            trust = 1.0 / (1.0 + (gap / width) ** 2 / within)
            toward = apart / np.linalg.norm(apart)
            centers = 2.0 * toward - (apart - position[i] + position[j])  # if docks just touched
            push = tolerance**2 * trust * stretch / min(contacts[i], contacts[j])
            push *= centers / max(np.linalg.norm(centers), 1.0)
            across = (push - push @ toward * toward) * min(1.0, 2.0 / np.linalg.norm(apart))
            force[i] += across
            force[j] -= across
            torque[i] += np.cross(own, across - push)[2]
            torque[j] -= np.cross(its, across - push)[2]
    for robot in range(len(position)) if known.is_offset.any() else ():
        slope = [_offset_slope(known, position, yaw, tolerance, width, robot, k) for k in range(4)]
        force[robot] -= slope[:3]
        torque[robot] -= slope[3]
    for i in range(len(position)):
        for j in range(i + 1, len(position)):
            for a, own in enumerate(arm[i]):
                for b, other in enumerate(arm[j]):
                    apart = position[i] + own - position[j] - other
                    length = np.linalg.norm(apart)
                    if length < size:
                        left = 1 - touching[i, a, j, b]
                        push = -left * _slope_inside(length, size) * apart / length
                        force[i] += push
                        force[j] -= push
                        torque[i] += np.cross(own, push)[2]
                        torque[j] -= np.cross(other, push)[2]
    for row, (robot, normal, point, walk, precision) in enumerate(zip(*known.planes, strict=True)):
        walked = turn[robot] @ [*walk, 0.0]
        gap = normal @ (point - walked - position[robot])
        stiff = tolerance**2 * precision
        torn = 0.0 if _is_alone(known, row) else precision * (gap / width) ** 2
        hold = normal * gap * stiff / (1.0 + stiff + torn)
        force[robot] += hold
        torque[robot] += np.cross(walked, hold)[2]
    return force, torque - tolerance**2 * known.yaw_precision * yaw


def _is_alone(known, row):
    """Whether without that plane nothing would hold the robot's part along it."""
    of_part = known.part[known.planes.robot]
    is_other = (of_part == of_part[row]) & (np.arange(len(of_part)) != row)
    others, normal = known.planes.direction[is_other], known.planes.direction[row]
    span = np.linalg.pinv(others) @ others if is_other.any() else np.zeros((3, 3))
    return of_part[row] != known.part[0] and np.linalg.norm(normal - span @ normal) > 1e-9


def _distances(known, position, turn):
    """Robots of each distance, horizontal arms, vector between the docks, and docks of a touch."""
    level = np.array([1.0, 1.0, 0.0])
    for row in np.flatnonzero(~known.is_offset):
        i, j, docks = known.robot[row], known.neighbor[row], ()
        own, its = (np.append(arm, 0.0) for arm in np.split(known.lever[row], 2))
        own = own + np.array([0.0, 0.0, known.shift[row, 2]])
        if row in known.rows.touch:
            docks, own, its = _nearest_docks(known.rows, row, position, turn)
        own, its = turn[i] @ own, turn[j] @ its
        yield i, j, own * level, its * level, position[i] + own - position[j] - its, docks


def _nearest_docks(rows, row, position, turn):
    """Docks of a touch whose distance is nearest to D, earlier robot first; arms as sensed."""
    walks, d = rows.odometry, rows.distances
    i, j, every = rows.robot[row], rows.neighbor[row], range(rows.odometry.arm.shape[1])
    best = np.inf, None
    for a in every if d.dock[row] < 0 else [d.dock[row]]:
        for b in every if d.other_dock[row] < 0 else [d.other_dock[row]]:
            own = walks.shift[d.stance[row]] + walks.arm[d.stance[row], a]
            its = walks.arm[d.other_stance[row], b]
            apart = position[i] + turn[i] @ own - position[j] - turn[j] @ its
            off = abs(np.linalg.norm(apart) - d.length[row])
            best = min(best, (off, ((j, b, i, a), own, its)), key=lambda found: found[0])
    return best[1]


def _offset_slope(known, position, yaw, tolerance, width, robot, coordinate, h=1e-30):
    """Slope of the energy of all offsets by a coordinate or the yaw of a robot, a complex step."""
    position, yaw = position.astype(complex), yaw.astype(complex)
    if coordinate < 3:
        position[robot, coordinate] += 1j * h
    else:
        yaw[robot] += 1j * h
    cos, sin, energy = np.cos(yaw), np.sin(yaw), 0.0
    rows = known.rows
    count, total = len(rows.distances.stance), len(rows.neighbor)
    turn = [np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            for c, s in zip(cos, sin, strict=True)]  # fmt: skip
    for row in range(count, total, 3):
        i, j = rows.robot[row], rows.neighbor[row]
        seen = turn[i].T @ (position[j] + turn[j] @ rows.neighbor_arm[row] - position[i])
        off = rows.offsets.axis[row - count : row - count + 3] @ (rows.arm[row] - seen)
        along, *across = known.variance[row : row + 3]
        within = tolerance**2 + np.array([along, np.mean(across), np.mean(across)])
        square = (off**2 / within).sum()
        loss = width**2 * np.log(1.0 + square / width**2) if np.isfinite(width) else square
        energy = energy + 0.5 * tolerance**2 * loss
    return np.imag(energy) / h


def _slope_inside(length, size, h=1e-30):
    """Slope of the energy (size^2 - length^2)^2 / (8 size^2), by a complex step."""
    return np.imag((size**2 - (length + 1j * h) ** 2) ** 2 / (8.0 * size**2)) / h


def flip_paths(walk, step, body, k):
    """Dock paths of a flip about dock `k`, the short and the long way round, (60, 3, 3) each."""
    before = matrix(walk.orientation_wxyz[step])
    after = matrix(walk.orientation_wxyz[step + 1])
    pivot = walk.center[step] + before @ body[k]
    turn = Rotation.from_matrix(after @ before.T).as_rotvec()
    angle = np.linalg.norm(turn)
    for end in (angle, angle - 2.0 * np.pi):
        spin = Rotation.from_rotvec(np.linspace(0.0, end, 60)[:, None] * turn / angle)
        yield pivot + np.array([spin.apply(before @ (b - body[k])) for b in body]).swapaxes(0, 1)


def is_hidden(start, end, spheres, radius):
    """Whether the segment between two points meets any sphere: roots of quadratics in [0, 1]."""
    way, out = end - start, start - spheres
    a, b, c = way @ way, out @ way, (out**2).sum(axis=1) - radius**2
    inside = b * b - a * c
    root = -b - np.sqrt(np.maximum(inside, 0.0))
    return bool(((c < 0.0) | ((inside > 0.0) & (root > 0.0) & (root < a))).any())
