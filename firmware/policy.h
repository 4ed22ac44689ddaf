/* A trained policy in the robot: what fishmj/control/policy.py computes.
 *
 *     h_0 = o / scale,   h_l = f(W_l h_{l-1} + b_l),   a = tanh(W_L h_{L-1} + b_L)
 *
 * With memory m > 1 the input is the newest observation, then m - 1 pairs (action, observation) back in time; before the first
 * decision as if the fish had rested where it is. `fishmj deploy firmware-policy` writes the constants as a header; the caller
 * owns the memory: a window of FJ_POLICY_WINDOW floats, and two rows of FJ_POLICY_WIDEST fj_real to work in.
 *
 * Sums are in double precision unless the board defines FJ_REAL as float. Single precision is off by some 1e-6 of an action, as
 * NumPy on the host is, and faster where the processor has no double-precision unit.
 */
#ifndef FJ_POLICY_H
#define FJ_POLICY_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef FJ_REAL
#define FJ_REAL double
#endif
typedef FJ_REAL fj_real;

enum { FJ_RELU = 0, FJ_TANH = 1 };

typedef struct {
    uint16_t layers, observations, actions, memory;
    uint8_t activation;
    float control_dt;              /* s between two decisions, 0 where the policy does not say */
    const uint16_t *width;         /* layers + 1 of them: inputs, then outputs of each layer */
    const float *scale;            /* divisors of the observations */
    const float *const *weight;    /* of each layer, (outputs, inputs) row by row */
    const float *const *bias;      /* of each layer */
    const uint8_t *sha256;         /* of the policy's file */
} fj_policy;

typedef struct {
    float *window;    /* (memory - 1) x (actions + observations) */
    fj_real *work[2]; /* of the input's or the widest layer's size each */
    bool begun;
} fj_policy_memory;

/* Forget the past. */
void fj_policy_reset(fj_policy_memory *memory);

/* Decide: actions in [-1, 1] for observations in SI. False, and the memory stays, where an answer is not finite. */
bool fj_policy_decide(const fj_policy *policy, fj_policy_memory *memory, const float *observation, float *action);

#ifdef __cplusplus
}
#endif

#endif
