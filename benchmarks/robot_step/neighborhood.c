/* A round of Gauss-Newton: shifts and turns of the robots nearby, all others as they are. */
#include "robot.h"

enum { PARTS = 6, UNKNOWNS = PARTS * MOST_MOVING };

static float information[UNKNOWNS * (UNKNOWNS + 1) / 2]; /* lower triangle, row by row */
static float slope[UNKNOWNS];
static uint8_t leftmost[MOST_MOVING]; /* first robot that shares a row or an overlap with each */

static float *entries(int i) { return information + i * (i + 1) / 2; }

/* Adds the product of two derivatives by the robots in columns p >= q; of p = q, half of it. */
static void add_product(int p, int q, const float *one, const float *two, float weight)
{
    if (q < 0 || p < q) return;
    if (q < leftmost[p]) leftmost[p] = (uint8_t)q;
    for (int i = 0; i < PARTS; i++) {
        float *row = entries(PARTS * p + i) + PARTS * q, value = weight * one[i];
        for (int k = 0; k < (p == q ? i + 1 : PARTS); k++) row[k] += value * two[k];
    }
}

static void add_slope(int p, const float *derivative, float residual)
{
    for (int i = 0; p >= 0 && i < PARTS; i++) slope[PARTS * p + i] += derivative[i] * residual;
}

static void write_side(float *side, vec way, vec turned, vec turn_sd)
{
    vec turn = each(cross(way, turned), turn_sd);
    side[0] = way.x, side[1] = way.y, side[2] = way.z;
    side[3] = turn.x, side[4] = turn.y, side[5] = turn.z;
}

/* Rows that are missed by far give way, by Cauchy's loss; returns the loss beyond squares. */
static float give_way(const struct block *block, float robust_square, struct seen *seen)
{
    float excess = 0;
    for (int a = 0; a < block->rows; a++) {
        const struct row *row = block->row + a;
        int parts = row->kind == OFFSET ? 3 : 1, first = a - row->part;
        float missed = 0;
        for (int k = first; k < first + parts; k++)
            missed += seen[k].residual * seen[k].residual / block->row[k].variance;
        missed /= robust_square;
        seen[a].variance += row->variance * missed;
        excess += robust_square * (logf(1 + missed) - missed / (1 + missed)) / (float)parts;
    }
    return excess;
}

/* Replaces a Cholesky factor by the inverse of the matrix, both of its triangles. */
static void invert(int rows, float l[][MOST_ROWS])
{
    for (int k = 0; k < rows; k++) {
        l[k][k] = 1 / l[k][k];
        for (int a = k + 1; a < rows; a++) {
            float total = 0;
            for (int c = k; c < a; c++) total -= l[a][c] * l[c][k];
            l[a][k] = total / l[a][a];
        }
    }
    for (int a = 0; a < rows; a++)
        for (int k = 0; k <= a; k++) {
            float total = 0;
            for (int c = a; c < rows; c++) total += l[c][a] * l[c][k];
            l[k][a] = total; /* above the factor, which later columns need */
        }
}

/* Adds the rows of a block; returns their chi-square. */
static float add_rows(const struct neighborhood *near, const struct block *block)
{
    static struct seen seen[MOST_ROWS];
    static float weight[MOST_ROWS][MOST_ROWS], own[MOST_ROWS][PARTS], other[MOST_ROWS][PARTS];
    const struct held *robot = near->swarm.robot;
    int rows = block->rows, mine = near->column[block->own];
    see(block, &near->swarm, seen);
    float cost = near->robust_square > 0 ? give_way(block, near->robust_square, seen) : 0;
    factor(block, block->stances - 1, seen, weight);
    invert(rows, weight);
    for (int a = 0; a < rows; a++) {
        const struct row *row = block->row + a;
        write_side(own[a], seen[a].way, seen[a].tail, robot[block->own].turn_sd);
        write_side(other[a], times(-1, seen[a].way), seen[a].its, robot[row->other].turn_sd);
    }
    for (int a = 0; a < rows; a++) {
        int its = block->row[a].kind == COORDINATE ? -1 : near->column[block->row[a].other];
        float residual = 0, sum[PARTS] = {0};
        for (int b = 0; b < rows; b++) {
            float w = a < b ? weight[a][b] : weight[b][a];
            residual += w * seen[b].residual;
            for (int i = 0; i < PARTS; i++) sum[i] += w * own[b][i];
            int theirs = block->row[b].kind == COORDINATE ? -1 : near->column[block->row[b].other];
            add_product(its, theirs, other[a], other[b], w);
        }
        add_product(mine, mine, own[a], sum, 1);
        if (its >= 0) add_product(mine, its, sum, other[a], 1);
        add_slope(mine, own[a], residual);
        add_slope(its, other[a], residual);
        cost += seen[a].residual * residual;
    }
    return cost;
}

/* Adds the overlaps of docks of two robots that do not touch; returns their squares. */
static float add_overlaps(const struct neighborhood *near, int i, int k, vec arm[][DOCKS])
{
    const struct held *one = near->swarm.robot + i, *two = near->swarm.robot + k;
    vec between = sub(one->center, two->center);
    float cost = 0, side[PARTS], its[PARTS];
    if (dot(between, between) >= near->swarm.reach * near->swarm.reach) return 0;
    for (int d = 0; d < DOCKS; d++)
        for (int e = 0; e < DOCKS; e++) {
            vec apart = sub(add(between, arm[i][d]), arm[k][e]);
            float distance = norm(apart);
            if (distance >= SPACING || distance == 0) continue;
            if (touching(&near->swarm, i, d, k, e)) continue;
            vec way = times(1 / (distance * OVERLAP_SD), apart);
            float residual = (distance - SPACING) / OVERLAP_SD;
            int p = near->column[i], q = near->column[k];
            write_side(side, way, arm[i][d], one->turn_sd);
            write_side(its, times(-1, way), arm[k][e], two->turn_sd);
            add_product(p, p, side, side, 1);
            add_product(q, q, its, its, 1);
            add_product(p, q, side, its, 1);
            add_slope(p, side, residual);
            add_slope(q, its, residual);
            cost += residual * residual;
        }
    return cost;
}

/* Sums information and slope where the robots are; returns the cost. */
float linearize(const struct neighborhood *near)
{
    static vec arm[MOST_HELD][DOCKS];
    int unknowns = PARTS * near->moving;
    float cost = 0;
    for (int i = 0; i < unknowns * (unknowns + 1) / 2; i++) information[i] = 0;
    for (int i = 0; i < unknowns; i++) slope[i] = 0;
    for (int p = 0; p < near->moving; p++) leftmost[p] = (uint8_t)p;
    for (int i = 0; i < near->swarm.robots; i++) {
        const struct held *robot = near->swarm.robot + i;
        vec turn = each(robot->turn, robot->turn_sd);
        for (int d = 0; d < DOCKS; d++) arm[i][d] = undone(robot->arm[d], turn);
    }
    for (int b = 0; b < near->blocks; b++) cost += add_rows(near, near->block + b);
    for (int i = 0; i < near->swarm.robots; i++) {
        if (near->column[i] < 0) continue;
        for (int k = 0; k < near->swarm.robots; k++)
            if (k < i || (k > i && near->column[k] < 0)) cost += add_overlaps(near, i, k, arm);
        vec turn = near->swarm.robot[i].turn; /* its prior is one standard deviation */
        float prior[PARTS] = {0, 0, 0, turn.x, turn.y, turn.z};
        for (int c = 3; c < PARTS; c++) {
            int u = PARTS * near->column[i] + c;
            entries(u)[u] += 1;
            slope[u] += prior[c];
        }
        cost += dot(turn, turn);
    }
    return cost;
}

/* Holds the anchor where it is, if it is among those that move; its orientation is not. */
static void hold_anchor(void)
{
    for (int u = 0; u < 3; u++) {
        for (int i = u; i < UNKNOWNS; i++) entries(i)[u] = 0;
        for (int k = 0; k <= u; k++) entries(u)[k] = 0;
        entries(u)[u] = 1;
        slope[u] = 0;
    }
}

/* Takes the damped step toward the minimum; returns what it gains, as predicted. */
float step(const struct neighborhood *near)
{
    int unknowns = PARTS * near->moving;
    float y[UNKNOWNS], gain = 0;
    for (int u = 0; u < unknowns; u++)
        if (u % PARTS < 3) entries(u)[u] += near->damping;
    if (near->column[0] == 0) hold_anchor();
    for (int i = 0; i < unknowns; i++) { /* entries left of `leftmost` are zero, and stay so */
        float *row = entries(i), total = -slope[i];
        int from = PARTS * leftmost[i / PARTS];
        for (int k = from; k <= i; k++) {
            const float *above = entries(k);
            int first = PARTS * leftmost[k / PARTS];
            float entry = row[k];
            for (int c = first > from ? first : from; c < k; c++) entry -= row[c] * above[c];
            row[k] = k == i ? sqrtf(entry) : entry / above[k];
        }
        for (int k = from; k < i; k++) total -= row[k] * y[k];
        y[i] = total / row[i];
    }
    for (int i = unknowns - 1; i >= 0; i--) {
        const float *row = entries(i);
        y[i] /= row[i];
        for (int k = PARTS * leftmost[i / PARTS]; k < i; k++) y[k] -= row[k] * y[i];
    }
    for (int i = 0; i < near->swarm.robots; i++) {
        if (near->column[i] < 0) continue;
        int u = PARTS * near->column[i];
        struct held *robot = near->swarm.robot + i;
        vec shift = capped((vec){y[u], y[u + 1], y[u + 2]}, near->longest_step);
        vec turn = {y[u + 3], y[u + 4], y[u + 5]};
        gain -= dot((vec){slope[u], slope[u + 1], slope[u + 2]}, shift);
        gain -= dot((vec){slope[u + 3], slope[u + 4], slope[u + 5]}, turn);
        robot->center = add(robot->center, shift);
        robot->turn = add(robot->turn, turn);
    }
    return gain;
}
