/* Board with an ATmega328P at 16 MHz, like a Hapkit: magnetic angle sensor, motor bridge with PWM and direction.
 *
 * PWM on D5 (OC0B), direction on D8, sensor on A2; on D2 an emergency stop that closes to ground in normal operation
 * (internal pull-up, so that a broken wire stops). There is no force sensor: the operator's force is estimated as minus
 * the drive. The hardware watchdog resets a program that hangs; pull-downs then keep the bridge off.
 */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <string.h>

#include "../../core/handle.h"

#define BAUD_REGISTER 1 /* 1 Mbaud with U2X */
#define RING 128        /* a power of two */
#define TICK_US 1000
#define PWM_MOST 255
#define SENSOR_CHANNEL 2
#define SENSOR_RANGE 1024
/* Addresses of the id of the board and of the number of its last session. */
#define EEPROM_ID ((const void *)0)
#define EEPROM_SESSION ((uint16_t *)8)

static volatile uint8_t received[RING], sending[RING];
static volatile uint8_t received_head, received_tail, sending_head, sending_tail;
static volatile uint8_t ticks;
static volatile uint16_t sensor;

ISR(USART_RX_vect)
{
    uint8_t next = (uint8_t)((received_head + 1) & (RING - 1)), byte = UDR0;
    if (next != received_tail) {
        received[received_head] = byte;
        received_head = next;
    }
}

ISR(USART_UDRE_vect)
{
    if (sending_head == sending_tail) {
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
        return;
    }
    UDR0 = sending[sending_tail];
    sending_tail = (uint8_t)((sending_tail + 1) & (RING - 1));
}

ISR(TIMER1_COMPA_vect) { ticks++; }

ISR(ADC_vect) { sensor = ADC; }

static void queue(void *board, const uint8_t *wire, uint8_t length)
{
    uint8_t used = (uint8_t)((sending_head - sending_tail) & (RING - 1));
    (void)board;
    if (length > RING - 1 - used)
        return;
    for (uint8_t i = 0; i < length; i++)
        sending[(uint8_t)((sending_head + i) & (RING - 1))] = wire[i];
    sending_head = (uint8_t)((sending_head + length) & (RING - 1));
    UCSR0B |= 1 << UDRIE0;
}

static void prepare(void)
{
    wdt_enable(WDTO_30MS);
    DDRB |= 1 << PB0;
    DDRD |= 1 << PD5;
    PORTD |= 1 << PD2;
    /* Timer 0: fast PWM at 62.5 kHz on D5. */
    TCCR0A = (1 << WGM01) | (1 << WGM00);
    TCCR0B = 1 << CS00;
    /* Timer 1: ticks at 1 kHz. */
    TCCR1B = (1 << WGM12) | (1 << CS11);
    OCR1A = 1999;
    TIMSK1 = 1 << OCIE1A;
    ADMUX = (1 << REFS0) | SENSOR_CHANNEL;
    ADCSRA = (1 << ADEN) | (1 << ADSC) | (1 << ADATE) | (1 << ADIE) | (1 << ADPS2) | (1 << ADPS1) | (1 << ADPS0);
    UCSR0A = 1 << U2X0;
    UBRR0 = BAUD_REGISTER;
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
}

static void apply(int32_t drive)
{
    int32_t size = drive < 0 ? -drive : drive;
    uint8_t duty = (uint8_t)(size > PWM_MOST ? PWM_MOST : size);
    if (drive < 0)
        PORTB |= 1 << PB0;
    else
        PORTB &= (uint8_t)~(1 << PB0);
    OCR0B = duty;
    /* Duty 0 of a fast PWM still gives a spike, so the pin is disconnected from the timer. */
    if (duty)
        TCCR0A |= 1 << COM0B1;
    else
        TCCR0A &= (uint8_t)~(1 << COM0B1);
}

/* Returns the count over all turns: the sensor wraps several times over the travel, at a step above half a turn. */
static int32_t unwrapped(uint16_t raw)
{
    static int32_t turns;
    static uint16_t before;
    static uint8_t has_before;
    int16_t step = (int16_t)(raw - before);
    if (has_before && step > SENSOR_RANGE / 2)
        turns--;
    else if (has_before && step < -SENSOR_RANGE / 2)
        turns++;
    has_before = 1;
    before = raw;
    return turns * SENSOR_RANGE + raw;
}

int main(void)
{
    static struct handle handle;
    struct handle_identity identity;
    struct handle_sample sample;
    uint8_t served = 0, reset_cause = MCUSR;
    MCUSR = 0;
    prepare();
    memset(&identity, 0, sizeof identity);
    memset(&sample, 0, sizeof sample);
    eeprom_read_block(&identity.device_id, EEPROM_ID, sizeof identity.device_id);
    identity.session = (uint16_t)(eeprom_read_word(EEPROM_SESSION) + 1);
    identity.session += identity.session == 0;
    eeprom_update_word(EEPROM_SESSION, identity.session);
    identity.flags = HAS_POSITION_MODE | HAS_FORCE_MODE | FORCE_IS_ESTIMATED | HAS_ESTOP_INPUT | IS_BACK_DRIVABLE;
    identity.max_rate_hz = 1000;
    identity.reset_cause = reset_cause;
    memcpy(identity.model, "telenano avr328p", sizeof identity.model);
    handle_init(&handle, &identity, queue, 0);
    sei();
    for (;;) {
        uint8_t passed, byte;
        uint16_t raw;
        while (received_tail != received_head) {
            byte = received[received_tail];
            received_tail = (uint8_t)((received_tail + 1) & (RING - 1));
            handle_receive(&handle, byte);
        }
        passed = (uint8_t)(ticks - served);
        if (!passed)
            continue;
        served = (uint8_t)(served + passed);
        cli();
        raw = sensor;
        sei();
        sample.time_us += (uint32_t)passed * TICK_US;
        sample.position = unwrapped(raw);
        sample.flags = PIND & (1 << PD2) ? ESTOP_PRESSED : 0;
        /* Missed milliseconds also count for the watchdog. */
        handle.overruns = (uint16_t)(handle.overruns + passed - 1);
        handle.silent_ms = (uint16_t)(handle.silent_ms + passed - 1);
        handle_tick(&handle, &sample);
        apply(handle.drive);
        wdt_reset();
    }
}
