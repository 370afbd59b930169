component trued_watch """Between LinuxCNC and trued's Modbus server. mb2hal keeps the last values on its pins
when the server dies, and does not come back by itself: what it shows counts only while `alive`.""";

pin in s32 heartbeat "trued's: mb2hal.status.heartbeat.int";
pin in float timeout = 1.0 "how long it may stand still, s";
pin out bit alive "trued lives";
pin out s32 beat "LinuxCNC's, for trued: to mb2hal.alive.beat.int";

variable int started;
variable int last;
variable double still;
variable double since;

function _ fp;
license "Apache-2.0 OR MIT";
author "The trued contributors";
;;
FUNCTION(_) {
    /* What stands on the pin from the first is not yet a beat. */
    if (!started) {
        started = 1;
        last = heartbeat;
        still = timeout;
    }
    still += fperiod;
    if (heartbeat != last) {
        last = heartbeat;
        still = 0.0;
    }
    alive = still < timeout;
    since += fperiod;
    if (since >= 0.1) {
        since = 0.0;
        beat = (beat + 1) & 0x7fff;
    }
}
