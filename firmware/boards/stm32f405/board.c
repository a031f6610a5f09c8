#include "board.h"

#include "registers.h"

enum { UART_ROOM = 128 };

/* The only state of the board. */
struct state {
    uint8_t uart[UART_ROOM];
    uint32_t uart_head;
    uint32_t uart_tail;
};

static void clocks(void)
{
    /* 8 MHz crystal -> 168 MHz core, 42 MHz APB1, 84 MHz APB2: CAN wants a crystal. */
    RCC_CR |= 1u << 16;
    while (!(RCC_CR & (1u << 17))) {
    }
    FLASH_ACR = 5u | 7u << 8;
    RCC_PLLCFGR = 8u | 336u << 6 | 0u << 16 | 1u << 22 | 7u << 24;
    RCC_CR |= 1u << 24;
    while (!(RCC_CR & (1u << 25))) {
    }
    RCC_CFGR = 5u << 10 | 4u << 13 | 2u;
    while ((RCC_CFGR & (3u << 2)) != 2u << 2) {
    }
    RCC_AHB1ENR |= 7u;
    RCC_APB1ENR |= 1u << 0 | 1u << 3 | 1u << 25;
    RCC_APB2ENR |= 1u << 0 | 1u << 4 | 1u << 8 | 1u << 12;
}

static void pins(void)
{
    /* PA0, PA1: encoder (TIM5). PA8, PA9: bridge (TIM1). PA5..PA7: load cell (SPI1), PB1 its ready line.
     * PB6: serial (USART1). PB8, PB9: CAN. PA2, PA3, PA4, PB0, PC0..PC3: Hall signals. PB10: encoder good.
     * PB12: safe-torque-off, low from reset on. PB13: emergency stop, pulled up: a broken wire reads as pressed.
     * PB14: index, pulled down. */
    GPIOA_MODER = 0xA8000000u | 2u << 0 | 2u << 2 | 3u << 4 | 3u << 6 | 3u << 8 | 2u << 10 | 2u << 12 | 2u << 14 |
                  2u << 16 | 2u << 18;
    GPIOA_AFRL = 2u << 0 | 2u << 4 | 5u << 20 | 5u << 24 | 5u << 28;
    GPIOA_AFRH = 1u << 0 | 1u << 4;
    GPIOB_PUPDR = 0x00000100u | 1u << 26 | 2u << 28;
    GPIOB_MODER = 0x00000280u | 3u << 0 | 2u << 12 | 2u << 16 | 2u << 18 | 1u << 24;
    GPIOB_AFRL = 7u << 24;
    GPIOB_AFRH = 9u << 0 | 9u << 4;
    GPIOC_MODER = 0xFFu;
}

static void timers(void)
{
    TIM2_PSC = 83;
    TIM2_EGR = 1;
    TIM2_CR1 = 1;
    TIM5_CCMR1 = 0x0101u;
    TIM5_SMCR = 3;
    TIM5_CR1 = 1;
    TIM1_ARR = 4096; /* 20.5 kHz, centre-aligned */
    TIM1_CCMR1 = 0x6868u;
    TIM1_CCER = 0x0011u;
    TIM1_BDTR = 0;
    TIM1_CR1 = 1u | 1u << 5;
}

static void links(void)
{
    USART1_BRR = 91; /* 84 MHz / 921600 */
    USART1_CR1 = 1u << 13 | 1u << 3;
    SPI1_CR1 = 1u << 2 | 4u << 3 | 1u << 6 | 1u << 8 | 1u << 9 | 1u << 11;
    ADC1_SMPR2 = 0x0249249Bu;
    ADC1_CR2 = 1;
    CAN1_MCR = 1u | 1u << 2 | 1u << 6; /* frames leave in the order of sending; leave bus-off by itself */
    while (!(CAN1_MSR & 1u)) {
    }
    CAN1_BTR = 2u | 10u << 16 | 1u << 20; /* 42 MHz / 3 / (1 + 11 + 2) = 1 Mbit/s */
    CAN1_FMR |= 1;
    CAN1_FS1R = 1;
    CAN1_F0R1 = 0;
    CAN1_F0R2 = 0;
    CAN1_FA1R = 1;
    CAN1_FMR &= ~1u;
    CAN1_MCR &= ~3u;
    while (CAN1_MSR & 1u) {
    }
}

static uint32_t time_us(void *context)
{
    (void)context;
    return TIM2_CNT;
}

static uint16_t adc(void *context, uint32_t channel)
{
    /* PA2, PA3, PA4, PB0, PC0, PC1, PC2, PC3 */
    static const uint8_t input[8] = {2, 3, 4, 8, 10, 11, 12, 13};
    (void)context;
    ADC1_SQR1 = 0;
    ADC1_SQR3 = input[channel & 7u];
    ADC1_CR2 = 1u | 1u << 30;
    while (!(ADC1_SR & 2u)) {
    }
    return (uint16_t)ADC1_DR;
}

static uint32_t spi(uint32_t word)
{
    SPI1_DR = word;
    while (!(SPI1_SR & 1u)) {
    }
    return SPI1_DR & 0xFFFFu;
}

static bool load_cell(void *context, int32_t *counts)
{
    (void)context;
    if (GPIOB_IDR & (1u << 1)) { /* ready is low */
        return false;
    }
    const uint32_t word = spi(0) << 16 | spi(0);
    *counts = (int32_t)word >> 8;
    return true;
}

static bool encoder(void *context, int32_t *counts)
{
    (void)context;
    *counts = (int32_t)TIM5_CNT;
    return (GPIOB_IDR & (1u << 10)) == 0;
}

static bool index_mark(void *context)
{
    (void)context;
    return (GPIOB_IDR & (1u << 14)) != 0;
}

static bool emergency_stop(void *context)
{
    (void)context;
    return (GPIOB_IDR & (1u << 13)) != 0;
}

static void supply(void *context, bool on)
{
    (void)context;
    GPIOB_BSRR = on ? 1u << 12 : 1u << 28;
}

static void duty(void *context, int32_t value)
{
    (void)context;
    const uint32_t size = (uint32_t)(value < 0 ? -value : value) >> 3;
    TIM1_CCR1 = value > 0 ? size : 0;
    TIM1_CCR2 = value < 0 ? size : 0;
    TIM1_BDTR = value == 0 ? 0 : 1u << 15;
}

static void can_send(void *context, uint32_t id, const uint8_t data[8])
{
    (void)context;
    for (uint32_t mailbox = 0; mailbox < 3; mailbox++) {
        if (CAN1_TSR & (1u << (26 + mailbox))) {
            CAN1_TDTR(mailbox) = 8;
            CAN1_TDLR(mailbox) =
                (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
            CAN1_TDHR(mailbox) =
                (uint32_t)data[4] | (uint32_t)data[5] << 8 | (uint32_t)data[6] << 16 | (uint32_t)data[7] << 24;
            CAN1_TIR(mailbox) = id << 21 | 1u;
            return;
        }
    }
    /* every mailbox is still full: a newer sample comes in a millisecond */
}

static bool can_receive(void *context, uint32_t *id, uint8_t data[8], uint32_t *length)
{
    (void)context;
    if (!(CAN1_RF0R & 3u)) {
        return false;
    }
    const uint32_t low = CAN1_RDL0R;
    const uint32_t high = CAN1_RDH0R;
    *id = CAN1_RI0R >> 21;
    *length = CAN1_RDT0R & 15u;
    for (uint32_t i = 0; i < 4; i++) {
        data[i] = (uint8_t)(low >> (8 * i));
        data[4 + i] = (uint8_t)(high >> (8 * i));
    }
    CAN1_RF0R = 1u << 5;
    return true;
}

static void uart_send(void *context, const uint8_t *bytes, size_t length)
{
    struct state *state = context;
    if (length > UART_ROOM - (state->uart_head - state->uart_tail)) {
        return; /* the line is slower than the samples: drop the whole frame, never a part of one */
    }
    for (size_t i = 0; i < length; i++) {
        state->uart[state->uart_head % UART_ROOM] = bytes[i];
        state->uart_head++;
    }
}

static const void *calibration(void *context)
{
    (void)context;
    return CALIBRATION_PAGE;
}

const struct nr_board *board_start(void)
{
    static struct state state;
    static struct nr_board board;
    board = (struct nr_board){
        .context = &state,
        .time_us = time_us,
        .adc = adc,
        .load_cell = load_cell,
        .encoder = encoder,
        .index = index_mark,
        .emergency_stop = emergency_stop,
        .duty = duty,
        .supply = supply,
        .can_send = can_send,
        .can_receive = can_receive,
        .uart_send = uart_send,
        .calibration = calibration,
    };
    clocks();
    pins();
    timers();
    links();
    IWDG_KR = 0x5555u;
    IWDG_PR = 0;
    IWDG_RLR = 160; /* 20 ms at 32 kHz / 4 */
    IWDG_KR = 0xCCCCu;
    return &board;
}

void board_idle(const struct nr_board *board, bool ticked)
{
    struct state *state = board->context;
    if (ticked) {
        IWDG_KR = 0xAAAAu;
    }
    while (state->uart_tail != state->uart_head && (USART1_SR & (1u << 7))) {
        USART1_DR = state->uart[state->uart_tail % UART_ROOM];
        state->uart_tail++;
    }
}
