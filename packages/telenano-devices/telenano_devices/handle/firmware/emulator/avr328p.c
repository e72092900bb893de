/* The flashable image of boards/avr328p in simavr, as a library: bytes, sensor and switch in, bytes and drive out.
 *
 * Time is that of the processor: the caller runs it by cycles, and nothing here waits. simavr is GPL-3; this file is a
 * tool beside the firmware and no part of the Python package.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_hex.h>

#define FREQUENCY_HZ 16000000
#define SUPPLY_MV 5000
#define ROOM 8192
/* Addresses in the data space of the ATmega328P. */
#define PORTB_ADDRESS 0x25
#define TCCR0A_ADDRESS 0x44
#define OCR0B_ADDRESS 0x48
#define COM0B1_BIT 5
#define ESTOP_PIN 2
#define SENSOR_IRQ ADC_IRQ_ADC2

struct board {
    avr_t *avr;
    avr_irq_t *to_device;
    uint8_t sent[ROOM];
    uint32_t sent_length;
    uint32_t held_at;
    uint8_t held[2];
};

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct board *board = param;
    (void)irq;
    if (board->sent_length < ROOM)
        board->sent[board->sent_length++] = (uint8_t)value;
}

static void quiet(avr_t *avr, const int level, const char *format, va_list arguments)
{
    (void)avr, (void)level, (void)format, (void)arguments;
}

/* Returns a board with an image (Intel hex) and the first bytes of its EEPROM; NULL if the image cannot be read. */
struct board *board_new(const char *hex, const uint8_t *eeprom, uint32_t eeprom_length)
{
    uint32_t size = 0, start = 0, flags = 0;
    avr_eeprom_desc_t memory = {.ee = (uint8_t *)eeprom, .offset = 0, .size = eeprom_length};
    struct board *board = calloc(1, sizeof *board);
    uint8_t *code;
    avr_global_logger_set(quiet);
    code = read_ihex_file(hex, &size, &start);
    board->avr = code ? avr_make_mcu_by_name("atmega328p") : NULL;
    if (!board->avr) {
        free(code);
        free(board);
        return NULL;
    }
    avr_init(board->avr);
    board->avr->frequency = FREQUENCY_HZ;
    board->avr->vcc = board->avr->avcc = board->avr->aref = SUPPLY_MV;
    avr_loadcode(board->avr, code, size, start);
    board->avr->codeend = board->avr->flashend;
    free(code);
    avr_ioctl(board->avr, AVR_IOCTL_EEPROM_SET, &memory);
    /* Disable the echo on the console, and the pause of the host when the program polls. */
    avr_ioctl(board->avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(board->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(board->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, board);
    board->to_device = avr_io_getirq(board->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    return board;
}

void board_free(struct board *board)
{
    avr_terminate(board->avr);
    free(board->avr);
    free(board);
}

/* Runs the processor for a number of cycles; returns 0 if it has crashed or ended. */
int board_run(struct board *board, uint64_t cycles)
{
    uint64_t until = board->avr->cycle + cycles;
    while (board->avr->cycle < until) {
        int state = avr_run(board->avr);
        if (state == cpu_Done || state == cpu_Crashed)
            return 0;
    }
    return 1;
}

void board_receive(struct board *board, const uint8_t *bytes, uint32_t length)
{
    for (uint32_t i = 0; i < length; i++)
        avr_raise_irq(board->to_device, bytes[i]);
}

uint32_t board_sent(struct board *board, uint8_t *bytes, uint32_t room)
{
    uint32_t length = board->sent_length < room ? board->sent_length : room;
    memcpy(bytes, board->sent, length);
    board->sent_length = 0;
    return length;
}

void board_set_sensor(struct board *board, uint32_t millivolts)
{
    avr_raise_irq(avr_io_getirq(board->avr, AVR_IOCTL_ADC_GETIRQ, SENSOR_IRQ), millivolts);
}

/* Opens (1) or closes (0) the switch of the emergency stop; open, like a broken wire, the pull-up sets the pin. */
void board_set_estop(struct board *board, uint32_t open)
{
    avr_ioport_external_t closed = {.name = 'D', .mask = 1 << ESTOP_PIN, .value = open ? 1 << ESTOP_PIN : 0};
    avr_ioctl(board->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &closed);
    avr_raise_irq(avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), ESTOP_PIN), open);
}

/* Returns the duty of the bridge at its pins, -255 to 255; 0 if the timer does not drive the pin. */
int32_t board_drive(struct board *board)
{
    const uint8_t *data = board->avr->data;
    int32_t duty = data[TCCR0A_ADDRESS] >> COM0B1_BIT & 1 ? data[OCR0B_ADDRESS] : 0;
    return data[PORTB_ADDRESS] & 1 ? -duty : duty;
}

/* Stops the program by a jump to itself, or lets it continue. */
void board_hold(struct board *board, uint32_t hold)
{
    uint8_t *at = board->avr->flash;
    if (hold) {
        board->held_at = board->avr->pc;
        memcpy(board->held, at + board->held_at, sizeof board->held);
        at[board->held_at] = 0xFF;
        at[board->held_at + 1] = 0xCF;
    } else {
        memcpy(at + board->held_at, board->held, sizeof board->held);
    }
}

uint64_t board_cycles(struct board *board) { return board->avr->cycle; }
