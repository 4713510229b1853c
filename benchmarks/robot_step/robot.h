/* What the steps of a robot share. Lengths in R, angles in rad, single precision throughout. */
#ifndef ROBOT_H
#define ROBOT_H

#include <math.h>
#include <stdint.h>

enum { DOCKS = 3, MOST_HELD = 24, MOST_MOVING = 20, MOST_ROWS = 32, STARTS = 48 };

static const float SPACING = 2.0f; /* D: distance of the centers of two docks that touch */
static const float OVERLAP_SD = 0.05f;

typedef struct { float x, y, z; } vec;

static inline vec add(vec a, vec b) { return (vec){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec sub(vec a, vec b) { return (vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec times(float s, vec a) { return (vec){s * a.x, s * a.y, s * a.z}; }
static inline vec each(vec a, vec b) { return (vec){a.x * b.x, a.y * b.y, a.z * b.z}; }
static inline float dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline float norm(vec a) { return sqrtf(dot(a, a)); }
static inline float larger(float a, float b) { return a > b ? a : b; }
static inline vec capped(vec a, float most)
{
    float length = norm(a);
    return length > most ? times(most / length, a) : a;
}
static inline vec cross(vec a, vec b)
{
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* Algorithm 1: one robot joins those that are placed. */

struct placed { vec center, arm[DOCKS]; };
struct touch { uint8_t dock, other, its; }; /* own dock, an earlier robot, its dock */
struct gains { float attraction, repulsion, height, initial_offset, max_step; };
struct join {
    const struct placed *earlier;
    const struct touch *touch;
    int count, touches; /* earlier robots, contacts with them */
    vec arm[DOCKS];
    float height; /* NAN where unknown */
};

vec place_by_virtual_forces(const struct join *join, const struct gains *gains, int steps);

/* Rows: what one robot sensed of those that it met. */

enum kind { DISTANCE, HINGE, OFFSET, COORDINATE };

struct row {
    vec axis, arm, first, other_arm; /* first: part of the arm that the row's own stance turns */
    float value, own_variance, variance;
    uint8_t kind, other, stance, part; /* part: 0, 1, 2 of an offset */
};
struct stance { vec reached, turn_sd; }; /* reached: part of the arms of all earlier stances */
struct block { /* stance: from the earliest of a row to the final one */
    const struct row *row;
    const struct stance *stance;
    uint8_t own, rows, stances;
};
struct held { vec center, turn, turn_sd, arm[DOCKS]; }; /* turn in standard deviations */
struct contact { uint8_t later, dock, earlier, its; };
struct swarm {
    struct held *robot;
    const struct contact *contact;
    int robots, contacts;
    float reach; /* distance of centers beyond which no docks overlap */
};
struct seen { vec way, tail, its; float residual, variance; };

vec undone(vec arm, vec turn);
void see(const struct block *block, const struct swarm *swarm, struct seen *seen);
void factor(const struct block *block, int noisy, const struct seen *seen, float l[][MOST_ROWS]);
int touching(const struct swarm *swarm, int robot, int dock, int other, int its);

/* Gauss-Newton for the robots nearby. */

struct neighborhood {
    struct swarm swarm;
    const struct block *block;
    int blocks, moving;
    int8_t column[MOST_HELD]; /* place of each robot among those that move, -1 if it stays */
    float robust_square, damping, longest_step;
};

float linearize(const struct neighborhood *near);
float step(const struct neighborhood *near);

/* Where a robot that joins may be. */

struct search {
    const vec *sphere; /* STARTS points of the unit sphere */
    int rounds, merge_every, most;
    float settled, alike, damping, longest_step, distinct, extension, worst;
};

int find_candidates(const struct block *block, const struct swarm *swarm,
                    const struct search *search, vec *place, float *cost);

#endif
