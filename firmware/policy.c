#include "policy.h"

#include <math.h>
#include <string.h>

void fj_policy_reset(fj_policy_memory *memory) {
    memory->begun = false;
}

/* One output: b + W h. */
static fj_real weighted(const float *weight, const fj_real *input, uint16_t count, float bias) {
    fj_real sum = (fj_real)bias;
    for (uint16_t i = 0; i < count; i++) sum += (fj_real)weight[i] * input[i];
    return sum;
}

bool fj_policy_decide(const fj_policy *policy, fj_policy_memory *memory, const float *observation, float *action) {
    const uint16_t seen = policy->observations, did = policy->actions;
    const size_t pair = (size_t)seen + did, window = pair * (policy->memory - 1u);
    fj_real *now = memory->work[0], *next = memory->work[1];

    for (uint16_t i = 0; i < seen; i++) now[i] = (fj_real)(observation[i] / policy->scale[i]);
    for (size_t i = 0; i < window; i++) {
        size_t at = i % pair; /* before the first decision: no action, and what is seen now */
        now[seen + i] = memory->begun ? (fj_real)memory->window[i] : at < did ? (fj_real)0 : now[at - did];
    }

    for (uint16_t layer = 0; layer < policy->layers; layer++) {
        const uint16_t from = policy->width[layer], to = policy->width[layer + 1];
        const bool last = layer + 1 == policy->layers;
        for (uint16_t k = 0; k < to; k++) {
            fj_real value = weighted(policy->weight[layer] + (size_t)k * from, now, from, policy->bias[layer][k]);
            if (last || policy->activation == FJ_TANH) value = (fj_real)tanhf((float)value);
            else if (value < (fj_real)0) value = (fj_real)0; /* not fmax, which hides nan */
            next[k] = value;
        }
        fj_real *spare = now;
        now = next;
        next = spare;
    }
    for (uint16_t k = 0; k < did; k++) {
        if (!isfinite(now[k])) return false;
    }
    for (uint16_t k = 0; k < did; k++) action[k] = (float)now[k];
    if (window == 0) return true;

    /* The new pair goes to the front; before the first decision the others are what is seen now, without actions. */
    if (memory->begun) memmove(memory->window + pair, memory->window, (window - pair) * sizeof(float));
    for (size_t i = 0; i < (memory->begun ? pair : window); i++) {
        size_t at = i % pair;
        memory->window[i] = at >= did ? observation[at - did] / policy->scale[at - did] : i < pair ? action[at] : 0.0f;
    }
    memory->begun = true;
    return true;
}
