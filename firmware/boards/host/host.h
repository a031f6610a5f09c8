/* The core as a shared library: the board is a `struct nr_board` of function pointers that the caller fills. */
#ifndef HOST_H
#define HOST_H

#include "../../core/nr_calibration.h"
#include "../../core/nr_identity.h"
#include "../../core/nr_frame.h"
#include "../../core/nr_trig.h"
#include "../../core/nr_motion.h"
#include "../../core/nr_guard.h"
#include "../../core/nr_hall.h"
#include "../../core/nr_torque.h"
#include "../../core/nr_drive.h"
#include "../../core/nr_board.h"
#include "../../core/nr_node.h"

#endif
