/* Rows of a block: what they miss, along what they change, how their noise is related. */
#include "robot.h"

/* Turns an arm by the rotation vector `-turn`; the series is right to 3e-6 up to 1 rad. */
vec undone(vec arm, vec turn)
{
    float square = dot(turn, turn);
    float sine = 1 - square / 6 * (1 - square / 20 * (1 - square / 42));
    float cosine = 0.5f - square / 24 * (1 - square / 30 * (1 - square / 56));
    vec across = cross(turn, arm);
    return add(sub(arm, times(sine, across)), times(cosine, cross(turn, across)));
}

/* Direction and residual of each row; the parts of both arms that final orientations turn. */
void see(const struct block *block, const struct swarm *swarm, struct seen *seen)
{
    const struct held *own = swarm->robot + block->own;
    vec own_turn = each(own->turn, own->turn_sd);
    int final = block->stances - 1;
    for (int a = 0; a < block->rows; a++) {
        const struct row *row = block->row + a;
        vec tail = row->stance == final ? row->first : block->stance[final].reached;
        vec turned = undone(tail, own_turn), its = {0, 0, 0}, way = row->axis;
        vec apart = sub(add(add(own->center, row->arm), turned), tail);
        if (row->kind != COORDINATE) {
            const struct held *other = swarm->robot + row->other;
            its = undone(row->other_arm, each(other->turn, other->turn_sd));
            apart = sub(apart, add(other->center, its));
        }
        float residual = dot(apart, way) - row->value;
        if (row->kind < OFFSET) {
            float length = norm(apart);
            residual = length - row->value;
            way = times(length > 0 ? 1 / length : 0, apart);
            if (row->kind == HINGE && residual >= 0) {
                way = (vec){0, 0, 0};
                residual = 0;
            }
        }
        seen[a] = (struct seen){way, turned, its, residual, row->own_variance};
    }
}

/* Cholesky factor of the covariance of the rows; the first `noisy` stances turn them together. */
void factor(const struct block *block, int noisy, const struct seen *seen, float l[][MOST_ROWS])
{
    int rows = block->rows;
    vec turn[MOST_ROWS];
    for (int a = 0; a < rows; a++) {
        for (int k = 0; k < a; k++) l[a][k] = 0;
        l[a][a] = seen[a].variance;
    }
    for (int s = 0; s < noisy; s++) {
        const struct stance *stance = block->stance + s;
        for (int a = 0; a < rows; a++) {
            const struct row *row = block->row + a;
            if (row->stance > s) continue;
            vec part = row->stance == s ? row->first : stance->reached;
            turn[a] = each(cross(seen[a].way, part), stance->turn_sd);
            for (int k = 0; k <= a; k++)
                if (block->row[k].stance <= s) l[a][k] += dot(turn[a], turn[k]);
        }
    }
    for (int a = 0; a < rows; a++)
        for (int k = 0; k <= a; k++) {
            float total = l[a][k];
            for (int c = 0; c < k; c++) total -= l[a][c] * l[k][c];
            l[a][k] = a == k ? sqrtf(total) : total / l[k][k];
        }
}

int touching(const struct swarm *swarm, int robot, int dock, int other, int its)
{
    if (robot < other) return touching(swarm, other, its, robot, dock);
    for (int t = 0; t < swarm->contacts; t++) {
        const struct contact *c = swarm->contact + t;
        if (c->later == robot && c->dock == dock && c->earlier == other && c->its == its) return 1;
    }
    return 0;
}
