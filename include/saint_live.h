/* The SAINT loss of saint-live: mean distance of points to spheres, and its slopes.
 *
 * Build:  cargo rustc --release --lib --features capi --crate-type cdylib
 * Link:   -L target/release -lsaint_live
 *
 * Metres, doubles. Nothing is kept after a call; calls from several threads are safe.
 * Every function that can fail returns SAINT_LIVE_OK or the reason, and then writes nothing.
 */
#ifndef SAINT_LIVE_H
#define SAINT_LIVE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SAINT_LIVE_ABI_VERSION 1

#define SAINT_LIVE_OK 0
#define SAINT_LIVE_NULL_POINTER 1 /* null where values are announced */
#define SAINT_LIVE_TOO_MANY 2     /* a count larger than memory */
#define SAINT_LIVE_BAD_VALUE 3    /* not finite; a negative radius or weight; Huber not above 0 */
#define SAINT_LIVE_BAD_OWNER 4    /* a point names a sphere that is not there */
#define SAINT_LIVE_BAD_PENALTY 5  /* none of the three below */
#define SAINT_LIVE_FAULT 6        /* a fault of the library */

#define SAINT_LIVE_ABSOLUTE 0 /* |s| */
#define SAINT_LIVE_SQUARED 1  /* s^2 */
#define SAINT_LIVE_HUBER 2    /* s^2/2 within huber_m, then huber_m (|s| - huber_m/2) */

/* A point that belongs to no sphere. */
#define SAINT_LIVE_NO_OWNER UINT32_MAX

typedef struct saint_live_loss_input {
    const double *points;    /* x y z each */
    size_t point_count;
    const double *spheres;   /* x y z radius each */
    size_t sphere_count;
    const uint32_t *owners;  /* one per point; NULL: the sphere whose surface is nearest */
    const double *weights;   /* one per point, >= 0; NULL: 1 each */
    uint32_t penalty;
    double huber_m;          /* looked at for SAINT_LIVE_HUBER alone */
} saint_live_loss_input;

/* SAINT_LIVE_ABI_VERSION of the library, to compare with this header's. */
uint32_t saint_live_abi_version(void);

/* value = sum(w * penalty(|p - c| - r)) / sum(w) over the points that have a sphere.
 * point_gradient: 3 per point, or NULL. sphere_gradient: x y z radius per sphere, or NULL.
 * Outputs must not overlap inputs. */
int32_t saint_live_loss(const saint_live_loss_input *input, double *value,
                        double *point_gradient, double *sphere_gradient);

#ifdef __cplusplus
}
#endif

#endif
