/* The step of kernels.py. Rows are unpacked into arrays first, so vector loads are contiguous: number
 * by number, which is what compilers make of it, or by hand, a dock at a time.
 */
#include <stdint.h>
#include <tgmath.h>

enum { ROW = 256, WIDTH = 8 };

typedef REAL Four __attribute__((vector_size(4 * sizeof(REAL)), aligned(sizeof(REAL))));
typedef __typeof__(_Generic((REAL)0, double: (int64_t)0, float: (int32_t)0)) Place;
typedef Place Places __attribute__((vector_size(4 * sizeof(REAL))));

/* Offsets from own docks to those of entries, by coordinate. */
static inline void unpack(const int32_t *row, int count, const REAL *own, const REAL *dock, REAL *dx,
                          REAL *dy, REAL *dz)
{
    for (int e = 0; e < count; e++) {
        const REAL *o = own + 4 * (row[e] >> 1 & 3);
        const REAL *p = dock + 4 * (row[e] >> 3);
        dx[e] = p[0] - o[0];
        dy[e] = p[1] - o[1];
        dz[e] = p[2] - o[2];
    }
}

static inline Four offset(int32_t entry, const REAL *own, const REAL *dock)
{
    return *(const Four *)(dock + 4 * (entry >> 3)) - *(const Four *)(own + 4 * (entry >> 1 & 3));
}

/* The same by hand: a dock is one load, and four offsets are transposed in registers. */
static inline void unpack_by_fours(const int32_t *row, int count, const REAL *own, const REAL *dock,
                                   REAL *dx, REAL *dy, REAL *dz)
{
    int e = 0;
    for (; e + 4 <= count; e += 4) {
        const Four a = offset(row[e], own, dock), b = offset(row[e + 1], own, dock);
        const Four c = offset(row[e + 2], own, dock), d = offset(row[e + 3], own, dock);
        const Four ab = __builtin_shuffle(a, b, (Places){0, 4, 1, 5});
        const Four cd = __builtin_shuffle(c, d, (Places){0, 4, 1, 5});
        const Four ab_z = __builtin_shuffle(a, b, (Places){2, 6, 3, 7});
        const Four cd_z = __builtin_shuffle(c, d, (Places){2, 6, 3, 7});
        *(Four *)(dx + e) = __builtin_shuffle(ab, cd, (Places){0, 1, 4, 5});
        *(Four *)(dy + e) = __builtin_shuffle(ab, cd, (Places){2, 3, 6, 7});
        *(Four *)(dz + e) = __builtin_shuffle(ab_z, cd_z, (Places){0, 1, 4, 5});
    }
    unpack(row + e, count - e, own, dock, dx + e, dy + e, dz + e);
}

typedef void Unpack(const int32_t *, int, const REAL *, const REAL *, REAL *, REAL *, REAL *);

/* Returns the largest squared distance from `origin`. */
static inline __attribute__((always_inline))
REAL step_by(Unpack unpack_row, int64_t robots, const int64_t *restrict first, const int64_t *restrict end,
               const int32_t *restrict entry, const REAL *restrict dock,
               const REAL *restrict dock_offset, const REAL *restrict position,
               const REAL *restrict origin, REAL attraction, REAL repulsion, REAL spacing,
               REAL max_step, REAL *restrict moved_position, REAL *restrict moved_dock)
{
    REAL farthest = 0;
    REAL dx[ROW], dy[ROW], dz[ROW], gain[ROW];
    for (int64_t i = 0; i < robots; i++) {
        const REAL *own = dock + 12 * i;
        const int32_t *row = entry + first[i];
        const int count = end[i] - first[i];
        unpack_row(row, count, own, dock, dx, dy, dz);
        for (int e = 0; e < count; e++)
            gain[e] = row[e] & 1 ? attraction : 0;
        int padded = count;
        for (; padded % WIDTH; padded++) {
            dx[padded] = spacing;
            dy[padded] = dz[padded] = gain[padded] = 0;
        }
        REAL fx = 0, fy = 0, fz = 0;
#pragma omp simd reduction(+ : fx, fy, fz)
        for (int e = 0; e < padded; e++) {
            REAL distance = sqrt(dx[e] * dx[e] + dy[e] * dy[e] + dz[e] * dz[e]);
            REAL gap = distance - spacing;
            REAL below = gap < 0 ? gap : 0, above = gap > 0 ? gap : 0;
            below *= below;
            REAL pull = (gain[e] * above - repulsion * below * below) / distance;
            fx += pull * dx[e];
            fy += pull * dy[e];
            fz += pull * dz[e];
        }
        REAL squared = fx * fx + fy * fy + fz * fz;
        REAL scale = squared > max_step * max_step ? max_step / sqrt(squared) : 1;
        REAL here[3] = {position[3 * i] + scale * fx, position[3 * i + 1] + scale * fy,
                        position[3 * i + 2] + scale * fz};
        squared = 0;
        for (int axis = 0; axis < 3; axis++) {
            moved_position[3 * i + axis] = here[axis];
            REAL way = here[axis] - origin[3 * i + axis];
            squared += way * way;
            for (int k = 0; k < 3; k++)
                moved_dock[12 * i + 4 * k + axis] = here[axis] + dock_offset[12 * i + 4 * k + axis];
        }
        farthest = squared > farthest ? squared : farthest;
    }
    return farthest;
}

#define STEP(name, unpack_row)                                                                     \
    REAL name(int64_t robots, const int64_t *restrict first, const int64_t *restrict end,          \
              const int32_t *restrict entry, const REAL *restrict dock,                            \
              const REAL *restrict dock_offset, const REAL *restrict position,                     \
              const REAL *restrict origin, REAL attraction, REAL repulsion, REAL spacing,          \
              REAL max_step, REAL *restrict moved_position, REAL *restrict moved_dock)             \
    {                                                                                              \
        return step_by(unpack_row, robots, first, end, entry, dock, dock_offset, position, origin, \
                       attraction, repulsion, spacing, max_step, moved_position, moved_dock);      \
    }
STEP(take_step, unpack)
STEP(take_step_by_fours, unpack_by_fours)

/* Reads and writes the bytes of a step in order, without its arithmetic: the streaming bound. */
REAL stream(int64_t robots, const int64_t *restrict first, const int64_t *restrict end,
            const int32_t *restrict entry, const REAL *restrict dock,
            const REAL *restrict dock_offset, const REAL *restrict position,
            const REAL *restrict origin, REAL attraction, REAL repulsion, REAL spacing,
            REAL max_step, REAL *restrict moved_position, REAL *restrict moved_dock)
{
    int32_t words = 0;
    for (int64_t i = 0; i < robots; i++) {
        for (int64_t e = first[i]; e < end[i]; e++)
            words ^= entry[e];
        for (int axis = 0; axis < 3; axis++)
            moved_position[3 * i + axis] = position[3 * i + axis] + origin[3 * i + axis];
        for (int k = 0; k < 12; k++)
            moved_dock[12 * i + k] = dock[12 * i + k] + dock_offset[12 * i + k];
    }
    return words == 1 ? spacing : 0;
}
