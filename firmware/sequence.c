#include "sequence.h"

bool fj_newer(uint32_t seq, uint32_t last) {
    uint32_t ahead = seq - last; /* wraps at 2^32 */
    return ahead != 0 && ahead < 0x80000000u;
}

static bool take(fj_gate *it, uint32_t seq, uint64_t time_us) {
    it->heard = true;
    it->last = seq;
    it->last_us = time_us;
    it->dropping = false;
    it->row = 0;
    return true;
}

bool fj_gate_accept(fj_gate *it, uint32_t seq, uint64_t time_us) {
    if (!it->heard || fj_newer(seq, it->last)) return take(it, seq, time_us);
    if (seq == it->last && time_us == it->last_us) return false;
    bool rising = !it->dropping || (fj_newer(seq, it->dropped) && time_us > it->dropped_us);
    it->row = rising ? it->row + 1 : 1;
    it->dropping = true;
    it->dropped = seq;
    it->dropped_us = time_us;
    bool anew = time_us > it->last_us || time_us + FJ_LATE_DATAGRAM_US < it->last_us || it->row >= FJ_PATIENCE;
    return anew ? take(it, seq, time_us) : false;
}
