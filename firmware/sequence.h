/* Which of the numbered datagrams are new. Equal to fishmj/deploy/protocols/sequence.py, which explains it. */
#ifndef FJ_SEQUENCE_H
#define FJ_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FJ_LATE_DATAGRAM_US 5000000u /* no datagram is under way for longer */
#define FJ_PATIENCE 10u              /* dropped datagrams in a row that count as a restart of the sender */

typedef struct {
    bool heard, dropping;
    uint32_t last, dropped;
    uint64_t last_us, dropped_us;
    uint32_t row;
} fj_gate;

bool fj_newer(uint32_t seq, uint32_t last);
bool fj_gate_accept(fj_gate *it, uint32_t seq, uint64_t time_us); /* begin with an fj_gate of zeros */

#ifdef __cplusplus
}
#endif

#endif
