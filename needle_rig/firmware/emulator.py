"""The real Cortex-M images under unicorn: every register that the nodes use is served from `Pins`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from needle_rig.errors import NeedleRigError
from needle_rig.firmware.pins import PAGE_SIZE, Pins

FLASH, FLASH_SIZE = 0x08000000, 1 << 20
RAM, RAM_SIZE = 0x20000000, 128 << 10
PERIPHERALS, PERIPHERALS_SIZE = 0x40000000, 0x100000
SYSTEM, SYSTEM_SIZE = 0xE0000000, 0x100000
PAGE = 0x080E0000

# Register addresses as in firmware/boards/stm32f405/registers.h, from PERIPHERALS.
TIM2_CNT, TIM5_CNT = 0x00024, 0x00C24
IWDG_KR = 0x03000
CAN_MCR, CAN_MSR, CAN_TSR, CAN_RF0R = 0x06400, 0x06404, 0x06408, 0x0640C
CAN_TI0R, CAN_TDL0R, CAN_TDH0R = 0x06580, 0x06588, 0x0658C
CAN_RI0R, CAN_RDT0R, CAN_RDL0R, CAN_RDH0R = 0x065B0, 0x065B4, 0x065B8, 0x065BC
TIM1_CCR1, TIM1_CCR2, TIM1_BDTR = 0x10034, 0x10038, 0x10044
USART_SR, USART_DR = 0x11000, 0x11004
ADC_SR, ADC_SQR3, ADC_DR = 0x12000, 0x12034, 0x1204C
SPI_SR, SPI_DR = 0x13008, 0x1300C
GPIOB_IDR = 0x20410
RCC_CR, RCC_CFGR = 0x23800, 0x23808

ADC_INPUTS = (2, 3, 4, 8, 10, 11, 12, 13)
QUIET_POLLS = 2
"""Turns of the main loop without a serial byte after which all that a tick had to say is out."""
INSTRUCTIONS_AT_MOST = 2_000_000


class ImageNode:
    """One image, started from its reset vector and held before its first poll."""

    def __init__(self, elf: Path, pins: Pins) -> None:
        import unicorn
        from unicorn.arm_const import UC_ARM_REG_SP

        self.pins = pins
        machine: Any = unicorn
        self._uc: Any = machine.Uc(machine.UC_ARCH_ARM, machine.UC_MODE_THUMB | machine.UC_MODE_MCLASS)
        self._uc.mem_map(FLASH, FLASH_SIZE)
        self._uc.mem_map(RAM, RAM_SIZE)
        self._uc.mem_map(SYSTEM, SYSTEM_SIZE)
        self._uc.mmio_map(PERIPHERALS, PERIPHERALS_SIZE, self._read, None, self._write, None)
        self._load(elf)
        self._uc.mem_write(PAGE, pins.page[:PAGE_SIZE])
        self._registers: dict[int, int] = {}
        self._spi_words: list[int] = []
        self._ticked = False
        self._polls = 0
        vectors = self._uc.mem_read(FLASH, 8)
        self._uc.reg_write(UC_ARM_REG_SP, int.from_bytes(vectors[:4], "little"))
        self._at = int.from_bytes(vectors[4:], "little")

    def poll(self) -> bool:
        """Run until the node has ticked and put out all bytes; True when it ticked.

        Raises NeedleRigError when the image faults or hangs.
        """
        from unicorn.arm_const import UC_ARM_REG_PC
        from unicorn.unicorn import UcError

        self._ticked, self._polls = False, 0
        try:
            self._uc.emu_start(self._at | 1, 0, count=INSTRUCTIONS_AT_MOST)
        except UcError as error:
            at = self._uc.reg_read(UC_ARM_REG_PC)
            raise NeedleRigError(
                f"image at 0x{at:08x}: {error}; rebuild it: needle-rig firmware build"
            ) from error
        self._at = self._uc.reg_read(UC_ARM_REG_PC)
        return self._ticked

    @property
    def ticked(self) -> bool:
        """Whether the running poll has come to its watchdog feed."""
        return self._ticked

    @property
    def emulator(self) -> Any:
        """The unicorn machine, for hooks that count."""
        return self._uc

    def _load(self, elf: Path) -> None:
        from elftools.elf.elffile import ELFFile

        with elf.open("rb") as stream:
            for segment in ELFFile(stream).iter_segments("PT_LOAD"):
                if segment["p_filesz"]:
                    self._uc.mem_write(segment["p_paddr"], segment.data())

    def _read(self, _uc: Any, offset: int, _size: int, _data: Any) -> int:
        pins, registers = self.pins, self._registers
        match offset:
            case 0x00024:  # TIM2_CNT
                self._polls += self._ticked
                if self._polls > QUIET_POLLS:
                    self._uc.emu_stop()
                return pins.time_us & 0xFFFFFFFF
            case 0x11000:  # USART_SR: room for a byte
                return 1 << 7
            case 0x06408:  # CAN_TSR: mailbox 0 empty
                return 1 << 26
            case 0x0640C:
                if self._ticked:
                    # Held at its look at the bus, which it repeats when it goes on.
                    self._uc.emu_stop()
                return min(len(pins.can_in), 3)
            case 0x065B0:
                return pins.can_in[0][0] << 21
            case 0x065B4:
                return len(pins.can_in[0][1])
            case 0x065B8:
                return int.from_bytes(pins.can_in[0][1][:4], "little")
            case 0x065BC:
                return int.from_bytes(pins.can_in[0][1][4:8], "little")
            case 0x00C24:
                return pins.encoder_counts & 0xFFFFFFFF
            case 0x20410:  # PB1: load cell not ready, PB10: encoder error
                return (pins.load_cell is None) << 1 | (not pins.encoder_good) << 10
            case 0x12000:
                return 2
            case 0x1204C:
                return pins.adc[ADC_INPUTS.index(registers[ADC_SQR3])]
            case 0x13008:
                return 1
            case 0x1300C:
                return self._spi_words.pop(0)
            case 0x23800:
                return registers.get(RCC_CR, 0) | 1 << 17 | 1 << 25
            case 0x23808:
                return registers.get(RCC_CFGR, 0) | 2 << 2
            case 0x06404:  # CAN_MSR: follows the request for initialisation
                return registers.get(CAN_MCR, 0) & 1
            case _:
                return registers.get(offset, 0)

    def _write(self, _uc: Any, offset: int, _size: int, value: int, _data: Any) -> None:
        pins, registers = self.pins, self._registers
        registers[offset] = value
        match offset:
            case 0x11004:
                pins.uart_out.append(value & 0xFF)
                self._polls = 0
            case 0x06580 if value & 1:
                low, high = registers[CAN_TDL0R], registers[CAN_TDH0R]
                pins.can_out.append((value >> 21, low.to_bytes(4, "little") + high.to_bytes(4, "little")))
            case 0x0640C if value & 1 << 5:
                pins.can_in.popleft()
            case 0x10044:  # TIM1_BDTR: the bridge switches after both compares were set
                forward, backward = registers.get(TIM1_CCR1, 0), registers.get(TIM1_CCR2, 0)
                pins.duty = (forward - backward) * 8 if value else 0
            case 0x1300C:
                self._shift_load_cell()
            case 0x03000 if value == 0xAAAA:
                self._ticked, self._polls = True, 0

    def _shift_load_cell(self) -> None:
        if not self._spi_words and self.pins.load_cell is not None:
            word = (self.pins.load_cell & 0xFFFFFF) << 8
            self._spi_words = [word >> 16, word & 0xFFFF]
        if len(self._spi_words) > 2:
            raise NeedleRigError("image: reads more words from the load cell than it has")
