#include "nr_node.h"

#include "../generated/needle_rig.h"

/* A loop that was held up for more than a tick does not catch up: it goes on from now. */
static bool due(uint32_t now_us, uint32_t *next_us)
{
    const uint32_t late_us = now_us - *next_us;
    if (late_us > UINT32_MAX / 2u) {
        return false;
    }
    *next_us = late_us < NR_TICK_US ? *next_us + NR_TICK_US : now_us + NR_TICK_US;
    return true;
}

/* After what the host waits for: where the controller has no room left, this one is lost. */
static void introduce(struct nr_identity *identity, const struct nr_board *board, uint32_t now_us)
{
    uint32_t id;
    uint8_t data[8] = {0};
    if (nr_identity_tick(identity, now_us, &id, data)) {
        board->can_send(board->context, id, data);
    }
}

void nr_torque_start(struct nr_torque_app *app, const struct nr_board *board)
{
    nr_torque_init(&app->node, board->calibration(board->context));
    app->next_us = board->time_us(board->context);
}

bool nr_torque_poll(struct nr_torque_app *app, const struct nr_board *board)
{
    const uint32_t now_us = board->time_us(board->context);
    if (!due(now_us, &app->next_us)) {
        return false;
    }
    int32_t counts = 0;
    uint8_t data[8] = {0};
    const bool converted = board->load_cell(board->context, &counts);
    const uint32_t id = nr_torque_tick(&app->node, now_us, counts, converted, data);
    board->can_send(board->context, id, data);
    introduce(&app->node.identity, board, now_us);
    return true;
}

void nr_hall_start(struct nr_hall_app *app, const struct nr_board *board)
{
    nr_hall_init(&app->node, board->calibration(board->context));
    app->next_us = board->time_us(board->context);
}

bool nr_hall_poll(struct nr_hall_app *app, const struct nr_board *board)
{
    const uint32_t now_us = board->time_us(board->context);
    if (!due(now_us, &app->next_us)) {
        return false;
    }
    struct nr_hall_pair pair[NR_HALL_SENSORS];
    for (uint32_t i = 0; i < NR_HALL_SENSORS; i++) {
        pair[i].sine = board->adc(board->context, 2 * i);
        pair[i].cosine = board->adc(board->context, 2 * i + 1);
    }
    uint8_t frame[NR_COBS_MAX_FRAME];
    const size_t length = nr_hall_tick(&app->node, now_us, pair, frame);
    board->uart_send(board->context, frame, length);
    return true;
}

void nr_drive_start(struct nr_drive_app *app, const struct nr_board *board, const struct nr_drive_config *config)
{
    nr_drive_init(&app->node, config, board->calibration(board->context));
    app->next_us = board->time_us(board->context);
    board->supply(board->context, false);
    board->duty(board->context, 0);
}

bool nr_drive_poll(struct nr_drive_app *app, const struct nr_board *board)
{
    uint32_t id;
    uint32_t length;
    uint8_t data[8];
    while (board->can_receive(board->context, &id, data, &length)) {
        nr_drive_receive(&app->node, board->time_us(board->context), id, data, length);
    }
    const uint32_t now_us = board->time_us(board->context);
    if (!due(now_us, &app->next_us)) {
        return false;
    }
    struct nr_drive_inputs in = {.counts = 0};
    in.encoder_good = board->encoder(board->context, &in.counts);
    in.index = board->index(board->context);
    in.emergency_stop = board->emergency_stop(board->context);
    struct nr_drive_outputs out;
    nr_drive_tick(&app->node, now_us, &in, &out);
    board->supply(board->context, out.supply);
    board->duty(board->context, out.duty);
    if (out.health_due) {
        board->can_send(board->context, NEEDLE_RIG_DRIVE_HEALTH_FRAME_ID, out.health);
    }
    board->can_send(board->context, NEEDLE_RIG_DRIVE_STATUS_FRAME_ID, out.status);
    introduce(&app->node.identity, board, now_us);
    return true;
}
