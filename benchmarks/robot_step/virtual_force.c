/* Algorithm 1: a robot that joins takes steps along the virtual forces of Eqs. (1) to (3). */
#include "robot.h"

/* Force on a dock, its partner at `apart`: attraction if farther than D, repulsion if nearer. */
static vec pair_force(vec apart, float attraction, float repulsion)
{
    float distance = norm(apart), gap = distance - SPACING;
    float pull = gap > 0 ? attraction * gap : -repulsion * gap * gap * gap * gap;
    return times(distance > 0 ? pull / distance : 0, apart);
}

static int connected(const struct join *join, int dock, int other, int its)
{
    for (int t = 0; t < join->touches; t++) {
        const struct touch *touch = join->touch + t;
        if (touch->dock == dock && touch->other == other && touch->its == its) return 1;
    }
    return 0;
}

static vec initial_place(const struct join *join, const struct gains *gains)
{
    vec total = {0, 0, 0};
    int count = 0;
    for (int t = 0; t < join->touches; t++) {
        int known = 0; /* each neighbor counts once */
        for (int e = 0; e < t; e++) known |= join->touch[e].other == join->touch[t].other;
        if (known) continue;
        total = add(total, join->earlier[join->touch[t].other].center);
        count++;
    }
    vec place = count ? times(1.0f / (float)count, total) : join->earlier[0].center;
    place.z += gains->initial_offset;
    return place;
}

vec place_by_virtual_forces(const struct join *join, const struct gains *gains, int steps)
{
    float longest = 0;
    for (int k = 0; k < DOCKS; k++) longest = larger(longest, norm(join->arm[k]));
    float reach = 2 * longest + SPACING;
    vec place = initial_place(join, gains);
    for (int t = 1; t <= steps; t++) {
        float ramp = (float)t / (float)steps;
        float attraction = gains->attraction * ramp, repulsion = gains->repulsion * (1 - ramp);
        vec force = {0, 0, 0};
        for (int k = 0; k < join->touches; k++) {
            const struct touch *touch = join->touch + k;
            const struct placed *other = join->earlier + touch->other;
            vec own = add(place, join->arm[touch->dock]);
            vec apart = sub(add(other->center, other->arm[touch->its]), own);
            force = add(force, pair_force(apart, attraction, repulsion));
        }
        for (int i = 0; i < join->count; i++) {
            const struct placed *other = join->earlier + i;
            vec between = sub(other->center, place);
            if (dot(between, between) >= reach * reach) continue;
            for (int own = 0; own < DOCKS; own++)
                for (int its = 0; its < DOCKS; its++) {
                    vec apart = sub(add(between, other->arm[its]), join->arm[own]);
                    if (dot(apart, apart) < SPACING * SPACING && !connected(join, own, i, its))
                        force = add(force, pair_force(apart, 0, repulsion));
                }
        }
        if (!isnan(join->height)) force.z += gains->height * (join->height - place.z);
        place = add(place, capped(force, gains->max_step));
    }
    return place;
}
