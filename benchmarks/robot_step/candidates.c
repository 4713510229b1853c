/* Where a robot that joins may be: minima of its own rows, from starts all over a sphere. */
#include "robot.h"

static struct seen seen[MOST_ROWS];
static float l[MOST_ROWS][MOST_ROWS];

/* Derivatives and residuals of all rows at a place, divided by the factor of their covariance. */
static float whiten(const struct block *block, const struct swarm *swarm, vec at, vec *way)
{
    static float missed[MOST_ROWS];
    float square = 0;
    swarm->robot[block->own].center = at;
    see(block, swarm, seen);
    factor(block, block->stances, seen, l);
    for (int a = 0; a < block->rows; a++) {
        vec v = seen[a].way;
        float r = seen[a].residual;
        for (int c = 0; c < a; c++) {
            v = sub(v, times(l[a][c], way[c]));
            r -= l[a][c] * missed[c];
        }
        way[a] = times(1 / l[a][a], v);
        missed[a] = r / l[a][a];
        seen[a].residual = missed[a];
        square += missed[a] * missed[a];
    }
    return square;
}

/* Solves the damped 3 x 3 system by cofactors. */
static vec toward_minimum(const vec *way, int rows, float damping)
{
    vec x = {damping, 0, 0}, y = {0, damping, 0}, z = {0, 0, damping}, slope = {0, 0, 0};
    for (int a = 0; a < rows; a++) {
        x = add(x, times(way[a].x, way[a]));
        y = add(y, times(way[a].y, way[a]));
        z = add(z, times(way[a].z, way[a]));
        slope = add(slope, times(seen[a].residual, way[a]));
    }
    vec by_x = cross(y, z), by_y = cross(z, x), by_z = cross(x, y);
    vec solved = {dot(by_x, slope), dot(by_y, slope), dot(by_z, slope)};
    return times(-1 / dot(x, by_x), solved);
}

static int merge(vec *place, int count, float alike)
{
    int kept = 0;
    for (int n = 0; n < count; n++) {
        int known = 0;
        for (int k = 0; k < kept; k++) known |= norm(sub(place[n], place[k])) < alike;
        if (!known) place[kept++] = place[n];
    }
    return kept;
}

/* Squares of overlaps of the robot with all others. */
static float overlaps(const struct swarm *swarm, int own)
{
    const struct held *robot = swarm->robot + own;
    float total = 0;
    for (int k = 0; k < swarm->robots; k++) {
        const struct held *other = swarm->robot + k;
        vec between = sub(robot->center, other->center);
        if (k == own || dot(between, between) >= swarm->reach * swarm->reach) continue;
        for (int e = 0; e < DOCKS; e++) {
            vec its = undone(other->arm[e], each(other->turn, other->turn_sd));
            for (int d = 0; d < DOCKS; d++) {
                float deep = SPACING - norm(add(sub(between, its), robot->arm[d]));
                if (deep > 0 && !touching(swarm, own, d, k, e))
                    total += deep * deep / (OVERLAP_SD * OVERLAP_SD);
            }
        }
    }
    return total;
}

/* Mean distance of a place to the robots that rows are about, each counted once. */
static float extension(const struct block *block, const struct swarm *swarm, vec at)
{
    float total = 0;
    int count = 0;
    for (int a = 0; a < block->rows; a++) {
        int known = block->row[a].kind == COORDINATE;
        for (int b = 0; b < a; b++)
            known |= block->row[b].kind != COORDINATE && block->row[b].other == block->row[a].other;
        if (known) continue;
        total += norm(sub(at, swarm->robot[block->row[a].other].center));
        count++;
    }
    return total / (float)count;
}

/* Spreads starts over the sphere that the sharpest distance leaves. */
static void spread(const struct block *block, const struct swarm *swarm, const vec *sphere,
                   vec *place)
{
    const struct row *best = 0;
    for (int a = 0; a < block->rows; a++) {
        const struct row *row = block->row + a;
        if (row->kind != COORDINATE && (!best || row->variance < best->variance)) best = row;
    }
    vec center = sub(add(swarm->robot[best->other].center, best->other_arm), best->arm);
    float radius = best->kind < OFFSET ? best->value : SPACING;
    for (int n = 0; n < STARTS; n++) place[n] = add(center, times(radius, sphere[n]));
}

/* Writes places and costs, the best first; returns their number. Both have room for all starts. */
int find_candidates(const struct block *block, const struct swarm *swarm,
                    const struct search *search, vec *place, float *cost)
{
    static vec way[MOST_ROWS];
    int count = STARTS, kept = 0;
    spread(block, swarm, search->sphere, place);
    for (int round = 1; round <= search->rounds; round++) {
        float farthest = 0;
        for (int n = 0; n < count; n++) {
            whiten(block, swarm, place[n], way);
            vec move = toward_minimum(way, block->rows, search->damping);
            farthest = larger(farthest, norm(move));
            place[n] = add(place[n], capped(move, search->longest_step));
        }
        if (round % search->merge_every == 0) count = merge(place, count, search->alike);
        if (farthest < search->settled) break;
    }
    for (int n = 0; n < count; n++) {
        cost[n] = whiten(block, swarm, place[n], way) + overlaps(swarm, block->own);
        cost[n] -= search->extension * extension(block, swarm, place[n]);
    }
    for (int n = 0; n < count && kept < search->most; n++) {
        int best = n;
        for (int k = n + 1; k < count; k++)
            if (cost[k] < cost[best]) best = k;
        vec at = place[best];
        float its = cost[best];
        place[best] = place[n];
        cost[best] = cost[n];
        if (kept && its > cost[0] + search->worst) break;
        int known = 0;
        for (int k = 0; k < kept; k++) known |= norm(sub(place[k], at)) <= search->distinct;
        if (!known) {
            place[kept] = at;
            cost[kept++] = its;
        }
    }
    return kept;
}
