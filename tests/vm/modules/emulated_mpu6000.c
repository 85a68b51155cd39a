// SPDX-License-Identifier: GPL-2.0 OR MIT
/*
 * An SPI controller with an MPU-6000 behind it, for a machine that has neither: registers, sample clock, FIFO, data-ready
 * interrupt and self-test as RM-MPU-6000A tells them. The kernel's own drivers bind to it: inv-mpu6000-spi (IIO), and spidev
 * by driver_override. Parameters, written under way, make the chip lie.
 */
#include <linux/hrtimer.h>
#include <linux/interrupt.h>
#include <linux/irq.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/spi/spi.h>

static short value[7] = {0, 0, 4096, 0, 0, 0, 0};
module_param_array(value, short, NULL, 0644);
MODULE_PARM_DESC(value, "readings: acceleration x y z, temperature, rate x y z");
static bool noise = true;
module_param(noise, bool, 0644);
MODULE_PARM_DESC(noise, "the lowest three bits of each reading are random");
static int error;
module_param(error, int, 0644);
MODULE_PARM_DESC(error, "each transfer fails with this errno");
static bool stopped;
module_param(stopped, bool, 0644);
MODULE_PARM_DESC(stopped, "no sample is taken");
static bool mute;
module_param(mute, bool, 0644);
MODULE_PARM_DESC(mute, "samples without interrupt");
static u8 who = 0x68;
module_param(who, byte, 0644);
MODULE_PARM_DESC(who, "WHO_AM_I");

enum {
	SELF_TEST_X = 0x0d, SELF_TEST_A = 0x10, DIVIDER = 0x19, CONFIG = 0x1a, GYRO_CONFIG = 0x1b, ACCEL_CONFIG = 0x1c,
	FIFO_ENABLE = 0x23, INT_ENABLE = 0x38, INT_STATUS = 0x3a, DATA = 0x3b, USER_CONTROL = 0x6a, POWER_1 = 0x6b,
	FIFO_COUNT = 0x72, FIFO_DATA = 0x74, WHO_AM_I = 0x75, REGISTERS = 0x80, FIFO_SIZE = 1024,
};
/* Self-test responses of factory code 1, at 250 deg/s and 8 g. */
enum { GYRO_RESPONSE = 3275, ACCEL_RESPONSE = 1393 };

static DEFINE_SPINLOCK(lock);
static u8 registers[REGISTERS];
static u8 fifo[FIFO_SIZE];
static unsigned int fifo_bytes;
static u32 random = 1;
static int interrupt = -1;
static struct hrtimer sample_timer;
static struct platform_device *platform;

static int clamped(int reading)
{
	return clamp(reading, -32768, 32767);
}

static void measure(void)
{
	unsigned int i;

	for (i = 0; i < 7; ++i) {
		int reading = value[i];

		random = random * 1664525 + 1013904223;
		if (noise)
			reading += (random >> 24 & 7) - 3;
		if (i < 3 && registers[ACCEL_CONFIG] & (0x80 >> i))
			reading += ACCEL_RESPONSE;
		if (i > 3 && registers[GYRO_CONFIG] & (0x80 >> (i - 4)))
			reading += i == 5 ? -GYRO_RESPONSE : GYRO_RESPONSE;
		reading = clamped(reading);
		registers[DATA + 2 * i] = (u16)reading >> 8;
		registers[DATA + 2 * i + 1] = (u8)reading;
	}
}

static void reset_chip(void)
{
	memset(registers, 0, sizeof(registers));
	registers[SELF_TEST_X] = registers[SELF_TEST_X + 1] = registers[SELF_TEST_X + 2] = 0x01;
	registers[SELF_TEST_A] = 0x15;
	registers[POWER_1] = 0x40;
	/* Linux 6.1 has no .int_status for this chip and looks at register 0 instead. */
	registers[0] = 0x01;
	fifo_bytes = 0;
	measure();
}

static void append(unsigned int from, unsigned int bytes)
{
	while (bytes-- > 0) {
		if (fifo_bytes == FIFO_SIZE) {
			registers[INT_STATUS] |= 0x10;
			return;
		}
		fifo[fifo_bytes++] = registers[from++];
	}
}

static u64 interval_ns(void)
{
	unsigned int filter = registers[CONFIG] & 7;

	return (filter == 0 || filter == 7 ? 125000 : 1000000) * (u64)(registers[DIVIDER] + 1);
}

static void take_sample(void)
{
	measure();
	if (registers[USER_CONTROL] & 0x40) {
		if (registers[FIFO_ENABLE] & 0x08)
			append(DATA, 6);
		if (registers[FIFO_ENABLE] & 0x80)
			append(DATA + 6, 2);
		if (registers[FIFO_ENABLE] & 0x70)
			append(DATA + 8, 6);
	}
	registers[INT_STATUS] |= 0x01;
}

/* A chip misses none when the machine is busy: those since the last call are taken now. */
static enum hrtimer_restart sample(struct hrtimer *timer)
{
	bool tell = false;
	unsigned long flags;
	u64 due;

	spin_lock_irqsave(&lock, flags);
	due = hrtimer_forward_now(timer, ns_to_ktime(interval_ns()));
	if (!(registers[POWER_1] & 0x40) && !stopped) {
		for (due = min_t(u64, due, FIFO_SIZE); due > 0; --due)
			take_sample();
		tell = registers[INT_ENABLE] & 0x01 && !mute;
	}
	spin_unlock_irqrestore(&lock, flags);
	if (tell)
		generic_handle_irq(interrupt);
	return HRTIMER_RESTART;
}

static u8 read_register(u8 address)
{
	u8 held = registers[address];

	switch (address) {
	case INT_STATUS:
		registers[INT_STATUS] = 0;
		return held;
	case FIFO_COUNT:
		return fifo_bytes >> 8;
	case FIFO_COUNT + 1:
		return (u8)fifo_bytes;
	case FIFO_DATA:
		if (fifo_bytes == 0)
			return 0xff;
		held = fifo[0];
		memmove(fifo, fifo + 1, --fifo_bytes);
		return held;
	case WHO_AM_I:
		return who;
	}
	return held;
}

static void write_register(u8 address, u8 to)
{
	if (address == POWER_1 && to & 0x80) {
		reset_chip();
		return;
	}
	if (address == USER_CONTROL && to & 0x04) {
		fifo_bytes = 0;
		to &= ~0x04;
	}
	registers[address] = to;
}

/* The first byte says where and whether to read; the address then goes on, but for the FIFO's. */
static int transfer(struct spi_controller *controller, struct spi_message *message)
{
	struct spi_transfer *part;
	unsigned int done = 0;
	bool reads = false;
	u8 address = 0;

	message->status = -error;
	message->actual_length = 0;
	list_for_each_entry(part, &message->transfers, transfer_list) {
		const u8 *out = part->tx_buf;
		u8 *in = part->rx_buf;
		unsigned long flags;
		unsigned int i;

		if (message->status)
			break;
		spin_lock_irqsave(&lock, flags);
		for (i = 0; i < part->len; ++i, ++done) {
			u8 sent = out ? out[i] : 0, received = 0;

			if (done == 0) {
				address = sent & 0x7f;
				reads = sent & 0x80;
			} else {
				if (reads)
					received = read_register(address);
				else
					write_register(address, sent);
				if (address != FIFO_DATA)
					address = (address + 1) & 0x7f;
			}
			if (in)
				in[i] = received;
		}
		spin_unlock_irqrestore(&lock, flags);
		message->actual_length += part->len;
		if (part->cs_change)
			done = 0;
	}
	spi_finalize_current_message(controller);
	return 0;
}

static int probe(struct platform_device *device)
{
	struct spi_board_info chip = {.modalias = "mpu6000", .max_speed_hz = 1000000, .mode = SPI_MODE_0};
	struct spi_controller *controller = devm_spi_alloc_master(&device->dev, 0);
	int failed;

	if (!controller)
		return -ENOMEM;
	controller->bus_num = 0;
	controller->num_chipselect = 1;
	controller->mode_bits = SPI_CPOL | SPI_CPHA;
	controller->transfer_one_message = transfer;
	failed = devm_spi_register_controller(&device->dev, controller);
	if (failed)
		return failed;
	chip.irq = interrupt;
	return spi_new_device(controller, &chip) ? 0 : -ENODEV;
}

static struct platform_driver driver = {.driver.name = "emulated-mpu6000", .probe = probe};

static int __init begin(void)
{
	int failed;

	reset_chip();
	interrupt = irq_alloc_desc(NUMA_NO_NODE);
	if (interrupt < 0)
		return interrupt;
	irq_set_chip_and_handler(interrupt, &dummy_irq_chip, handle_simple_irq);
	irq_modify_status(interrupt, IRQ_NOREQUEST | IRQ_NOAUTOEN, IRQ_NOPROBE);
	failed = platform_driver_register(&driver);
	if (failed)
		goto no_driver;
	platform = platform_device_register_simple("emulated-mpu6000", -1, NULL, 0);
	if (IS_ERR(platform)) {
		failed = PTR_ERR(platform);
		goto no_device;
	}
	hrtimer_init(&sample_timer, CLOCK_MONOTONIC, HRTIMER_MODE_REL);
	sample_timer.function = sample;
	hrtimer_start(&sample_timer, ms_to_ktime(1), HRTIMER_MODE_REL);
	return 0;

no_device:
	platform_driver_unregister(&driver);
no_driver:
	irq_free_desc(interrupt);
	return failed;
}

static void __exit end(void)
{
	hrtimer_cancel(&sample_timer);
	platform_device_unregister(platform);
	platform_driver_unregister(&driver);
	irq_free_desc(interrupt);
}

module_init(begin);
module_exit(end);
MODULE_LICENSE("Dual MIT/GPL");
MODULE_DESCRIPTION("an emulated MPU-6000 on an emulated SPI bus");
