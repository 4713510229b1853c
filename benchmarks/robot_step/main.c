/* Runs the steps on what `inputs.py` wrote, and prints a line for each run: what, which,
 * instructions, bytes of stack, and its results as the bits of floats. */
#include "board.h"
#include "robot.h"

#include "inputs.h"

static void put_word(uint32_t word)
{
    put(' ');
    for (int shift = 28; shift >= 0; shift -= 4) put("0123456789abcdef"[word >> shift & 15]);
}

static void put_floats(const float *values, int count)
{
    union { float real; uint32_t word; } bits;
    for (int k = 0; k < count; k++) {
        bits.real = values[k];
        put_word(bits.word);
    }
}

static void put_start(const char *what, int which, struct spent spent)
{
    while (*what) put(*what++);
    put_word((uint32_t)which);
    put_word(spent.instructions);
    put_word(spent.stack);
}

static void run_joins(void)
{
    for (int k = 0; k < JOINS; k++) {
        begin();
        vec place = place_by_virtual_forces(&joins[k], &gains, STEPS);
        put_start("virtual_force", k + 1, end());
        put_floats(&place.x, 3);
        put('\n');
    }
}

/* As `Neighborhood.solved`: steps to the minimum; the best state on the way is the result. */
static void run_rounds(void)
{
    static struct held best[MOST_HELD];
    float least = INFINITY, gain = INFINITY;
    for (int k = 0; k <= ROUNDS; k++) {
        begin();
        float cost = linearize(&near);
        struct spent spent = end();
        if (cost < least) {
            least = cost;
            for (int i = 0; i < near.swarm.robots; i++) best[i] = near.swarm.robot[i];
        }
        put_start("linearize", k, spent);
        put_floats(&cost, 1);
        put('\n');
        if (k == ROUNDS) break;
        begin();
        gain = step(&near);
        spent = end();
        put_start("step", k, spent);
        put_floats(&gain, 1);
        put('\n');
        if (gain < SETTLED) break;
    }
    put_start("state", 0, (struct spent){0, 0});
    put_floats(&least, 1);
    for (int i = 0; i < near.swarm.robots; i++) put_floats(&best[i].center.x, 6);
    put('\n');
}

static void run_search(void)
{
    vec place[STARTS];
    float cost[STARTS];
    struct held before = near.swarm.robot[joiner.own];
    begin();
    int count = find_candidates(&joiner, &near.swarm, &search, place, cost);
    put_start("candidates", 0, end());
    near.swarm.robot[joiner.own] = before;
    put_floats(cost, count);
    put_floats(&place[0].x, 3 * count);
    put('\n');
}

/* Bytes of what a robot holds for each step. */
static void put_sizes(void)
{
    put_start("held", 0, (struct spent){0, 0});
    put_word(sizeof placed + sizeof touches / JOINS);
    put_word(sizeof robots + sizeof contacts + sizeof rows + sizeof stances + sizeof blocks);
    put_word(sizeof robots + sizeof contacts + joiner.rows * sizeof(struct row)
             + joiner.stances * sizeof(struct stance));
    put('\n');
}

int main(void)
{
    put_sizes();
    run_joins();
    run_search();
    run_rounds();
    return 0;
}
