/* The guard of the base drive: decides, every tick, how fast the motor may turn, and stops it when in doubt.
 *
 * Integers only. Angles in millidegrees, velocities in 1e-4 deg/s, torques in 1e-5 N.mm (the raw units of the DBC),
 * times in microseconds of a counter that may wrap.
 *
 *   SILENT   after boot. Leaves only by a clear.
 *   READY    holds still, takes commands; SILENT again when the host goes quiet.
 *   RUNNING  an enabled command is in force.
 *   FAULT    stopped by the guard; `faults` says why. Leaves only by a clear, when the cause is gone.
 *
 * The motor's supply is on in READY and RUNNING alone, and RUNNING is entered once its contact has closed.
 *
 * A clear is a valid command with clear set, enable not set and zero velocity, that follows one without clear. It stands
 * until it is granted or the bit goes, and is granted once: a stuck bit clears nothing twice. Temporary faults (command
 * age, torque age, damaged frames) go with the first clear; the others are latching: they want a clear that a person
 * acknowledged, and the shaft still for `latch_us`. The clear says how long ago the person's newest status came. No cause
 * may have come after that, nor within `latch_us` before: the time of a status and a clear on their way. So nobody clears
 * what he has not seen, however late or often his clear comes. A latching cause that comes while the node stands in FAULT
 * is added to its faults; an emergency stop leads to FAULT from every state.
 *
 * Commands are those of one master: counter and heartbeat go on from the newest that was accepted. Others are not obeyed
 * and counted; a byte-for-byte repeat is not counted. Once nothing was accepted for `resync_us`, what comes is taken for
 * the master's new place in its sequence, but not obeyed.
 */
#ifndef NR_GUARD_H
#define NR_GUARD_H

#include "nr_motion.h"

#include <stdbool.h>
#include <stdint.h>

enum nr_state { NR_SILENT = 0, NR_READY = 1, NR_RUNNING = 2, NR_FAULT = 3 };

/* The low byte is DRIVE_STATUS.faults, the next one DRIVE_HEALTH.motion_faults. */
enum nr_fault {
    NR_FAULT_COMMAND_AGE = 1,
    NR_FAULT_HEARTBEAT = 2,
    NR_FAULT_VELOCITY = 4,
    NR_FAULT_ANGLE = 8,
    NR_FAULT_TORQUE_TRIP = 16,
    NR_FAULT_ENCODER = 32,
    NR_FAULT_FRAME = 64,
    NR_FAULT_TORQUE_AGE = 128,
    NR_FAULT_STALL = 256,
    NR_FAULT_RUNAWAY = 512,
    NR_FAULT_DIRECTION = 1024,
    NR_FAULT_IDLE_MOTION = 2048,
    NR_FAULT_MASTER = 4096,
    NR_FAULT_EMERGENCY_STOP = 8192,
    NR_FAULTS_TEMPORARY = NR_FAULT_COMMAND_AGE | NR_FAULT_FRAME | NR_FAULT_TORQUE_AGE
};

struct nr_guard_config {
    uint32_t command_age_us;    /* no valid command for longer: stop */
    uint32_t heartbeat_us;      /* commands come, their heartbeat stands still for longer: stop */
    uint32_t torque_age_us;     /* no valid torque for longer while running: stop */
    uint32_t latch_us;          /* stillness wanted before a latching fault may be cleared or a reference taken, and
                                 * time from the newest latching cause to the sight that a clear tells */
    uint32_t window_us;         /* over which damaged frames are counted */
    uint32_t contact_us;        /* from closing the supply to the first motion */
    uint32_t resync_us;         /* no command accepted for longer: the next sets counter and heartbeat anew */
    uint32_t foreign_us;        /* a command out of sequence is forgotten after so long */
    int32_t velocity_limit;     /* a command above it is a fault */
    int32_t angle_limit_mdeg;   /* commands that lead further out are held at zero */
    int32_t angle_margin_mdeg;  /* an angle further out than limit + margin is a fault */
    int32_t still_mdeg;         /* a shaft that stays within it stands still */
    int32_t torque_trip;
    uint16_t bad_frames_limit;  /* damaged frames within one window: a fault */
    uint16_t foreign_limit;     /* commands out of sequence that are not yet forgotten: a fault */
    struct nr_motion_config motion;
};

struct nr_command {
    int32_t velocity;
    bool enable;
    bool clear;
    bool acknowledge;           /* a person gave this clear */
    uint32_t sight_us;          /* and acknowledges what the drive said so long ago */
    uint8_t counter;
    uint16_t heartbeat;
};

/* What the node's own inputs say. */
struct nr_senses {
    int32_t angle_mdeg;
    bool encoder_good;
    bool emergency_stop;        /* pressed, or its wire is broken */
};

struct nr_guard {
    struct nr_guard_config config;
    enum nr_state state;
    uint16_t faults;
    bool supply;
    uint32_t supply_us;         /* when it was closed */
    struct nr_command command;
    bool command_seen;
    bool sequence_seen;
    uint8_t last_counter;
    uint16_t last_heartbeat;
    uint32_t sequence_us;       /* when counter and heartbeat were taken last */
    uint32_t foreign_us;        /* what is left until every command out of sequence is forgotten */
    bool last_clear;
    bool clear_asked;
    bool acknowledged;          /* the clear that is asked for */
    uint32_t sight_us;          /* when it was said what is acknowledged */
    uint32_t cause_us;          /* when a latching cause was there last */
    uint32_t command_us;
    uint32_t heartbeat_us;
    bool torque_seen;
    uint32_t torque_us;
    int32_t torque;
    uint16_t bad_frames;
    bool window_open;
    uint32_t window_start_us;
    uint32_t step_us;
    int32_t still_angle_mdeg;
    uint32_t still_since_us;
    int32_t permitted;
    bool referenced;
    struct nr_motion motion;
};

void nr_guard_init(struct nr_guard *guard, const struct nr_guard_config *config);

/* A command whose checksum was right. Gives false, and takes nothing from it, when its counter did not move on by one to
 * three or its heartbeat by none to three. */
bool nr_guard_command(struct nr_guard *guard, uint32_t now_us, const struct nr_command *command);

/* A torque whose frame was right; `good` false when the torque node says that its sensor is not. */
void nr_guard_torque(struct nr_guard *guard, uint32_t now_us, int32_t torque, bool good);

/* A frame that was meant for this node and damaged. */
void nr_guard_bad_frame(struct nr_guard *guard);

/* Somebody who knows the newest command's heartbeat says that the shaft stands at `angle_mdeg`. Gives whether that holds
 * from now on: not while RUNNING, and only for a shaft that stands still. */
bool nr_guard_reference(struct nr_guard *guard, uint32_t now_us, uint16_t heartbeat, int32_t angle_mdeg);

/* Once a tick. `asked` is the velocity that the drive asked of its motor since the last step, behind its ramp. Gives the
 * velocity that the motor may have now: 0 unless RUNNING. */
int32_t nr_guard_step(struct nr_guard *guard, uint32_t now_us, const struct nr_senses *senses, int32_t asked);

#endif
