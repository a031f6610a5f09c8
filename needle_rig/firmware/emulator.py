"""The real Cortex-M images under unicorn: every register that the nodes use is served from `Pins`."""

from __future__ import annotations

from collections.abc import Callable
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
GPIOB_IDR, GPIOB_BSRR = 0x20410, 0x20418
RCC_CR, RCC_CFGR = 0x23800, 0x23808
RCC_READY, RCC_ON_PLL = 1 << 17 | 1 << 25, 2 << 2

ADC_INPUTS = (2, 3, 4, 8, 10, 11, 12, 13)
LOOKS_AT_MOST = 20_000
"""Registers that a node may read in one poll: a loop that waits for what never comes is an error."""
EARLY_LOOKS = 200
"""Looks at the clock after which a node that does not tick is not due."""


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
        # What stands in a register for good: room for a byte and a frame, a conversion and a word done.
        self._registers = {
            USART_SR: 1 << 7,
            CAN_TSR: 1 << 26,
            ADC_SR: 2,
            SPI_SR: 1,
            RCC_CR: RCC_READY,
            RCC_CFGR: RCC_ON_PLL,
        }
        self._live: dict[int, Callable[[], int]] = {
            TIM2_CNT: self._time,
            CAN_RF0R: self._frames,
            CAN_RI0R: lambda: pins.can_in[0][0] << 21,
            CAN_RDT0R: lambda: len(pins.can_in[0][1]),
            CAN_RDL0R: lambda: int.from_bytes(pins.can_in[0][1][:4], "little"),
            CAN_RDH0R: lambda: int.from_bytes(pins.can_in[0][1][4:8], "little"),
            TIM5_CNT: lambda: pins.encoder_counts & 0xFFFFFFFF,
            GPIOB_IDR: self._inputs,
            SPI_DR: lambda: self._spi_words.pop(0),
        }
        self._acts: dict[int, Callable[[int], None]] = {
            USART_DR: lambda value: pins.uart_out.append(value & 0xFF),
            ADC_SQR3: self._convert,
            SPI_DR: self._shift_load_cell,
            CAN_TI0R: self._send,
            CAN_RF0R: self._release,
            CAN_MCR: lambda value: self._registers.__setitem__(CAN_MSR, value & 1),
            TIM1_BDTR: self._switch_bridge,
            GPIOB_BSRR: self._switch_supply,
            IWDG_KR: self._feed,
            RCC_CR: lambda value: self._registers.__setitem__(RCC_CR, value | RCC_READY),
            RCC_CFGR: lambda value: self._registers.__setitem__(RCC_CFGR, value | RCC_ON_PLL),
        }
        self._spi_words: list[int] = []
        self._ticked = False
        self._looks = self._early = self._hangs_at = 0
        vectors = self._uc.mem_read(FLASH, 16)
        self._uc.reg_write(UC_ARM_REG_SP, int.from_bytes(vectors[:4], "little"))
        self._at = int.from_bytes(vectors[4:8], "little")
        fault = int.from_bytes(vectors[12:], "little") & ~1
        self._uc.hook_add(machine.UC_HOOK_CODE, self._on_fault, None, fault, fault)

    def poll(self) -> bool:
        """Run until the node has ticked and put out all bytes; True when it ticked, False when it is not due.

        Raises NeedleRigError when the image faults or hangs.
        """
        from unicorn.arm_const import UC_ARM_REG_PC
        from unicorn.unicorn import UcError

        self._ticked, self._looks, self._early = False, 0, 0
        try:
            self._uc.emu_start(self._at | 1, 0)
        except UcError as error:
            at = self._uc.reg_read(UC_ARM_REG_PC)
            raise NeedleRigError(
                f"image at 0x{at:08x}: {error}; rebuild it: needle-rig firmware build"
            ) from error
        if self._hangs_at:
            raise NeedleRigError(f"image: hangs at its register 0x{self._hangs_at:08X}")
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
        self._looks += 1
        if self._looks > LOOKS_AT_MOST:
            self._uc.emu_stop()
            self._hangs_at = PERIPHERALS + offset
        live = self._live.get(offset)
        return self._registers.get(offset, 0) if live is None else live()

    def _write(self, _uc: Any, offset: int, _size: int, value: int, _data: Any) -> None:
        self._registers[offset] = value
        act = self._acts.get(offset)
        if act is not None:
            act(value)

    def _on_fault(self, *_: Any) -> None:
        raise NeedleRigError("image: came to its fault handler")

    # A node that has ticked is held at its next look at the clock or the bus, and repeats it when it goes on.

    def _time(self) -> int:
        self._early += 1
        if self._ticked or self._early > EARLY_LOOKS + len(self.pins.can_in):
            self._uc.emu_stop()
        return self.pins.time_us & 0xFFFFFFFF

    def _frames(self) -> int:
        if self._ticked:
            self._uc.emu_stop()
        return min(len(self.pins.can_in), 3)

    def _feed(self, key: int) -> None:
        self._ticked = self._ticked or key == 0xAAAA

    def _convert(self, channel: int) -> None:
        self._registers[ADC_DR] = self.pins.adc[ADC_INPUTS.index(channel)]

    def _send(self, mailbox: int) -> None:
        if mailbox & 1:
            low, high = self._registers[CAN_TDL0R], self._registers[CAN_TDH0R]
            data = low.to_bytes(4, "little") + high.to_bytes(4, "little")
            self.pins.can_out.append((mailbox >> 21, data))

    def _release(self, value: int) -> None:
        if value & 1 << 5:
            self.pins.can_in.popleft()

    def _switch_bridge(self, value: int) -> None:
        # The bridge switches after both compares were set.
        forward, backward = self._registers.get(TIM1_CCR1, 0), self._registers.get(TIM1_CCR2, 0)
        self.pins.duty = (forward - backward) * 8 if value else 0

    def _inputs(self) -> int:
        # PB1: load cell not ready, PB10: encoder error, PB13: emergency stop, PB14: index
        pins = self.pins
        low = (pins.load_cell is None) << 1 | (not pins.encoder_good) << 10
        return low | pins.emergency_stop << 13 | pins.index << 14

    def _switch_supply(self, value: int) -> None:
        if value & (1 << 12 | 1 << 28):
            self.pins.supply = bool(value & 1 << 12)

    def _shift_load_cell(self, _word: int) -> None:
        if not self._spi_words and self.pins.load_cell is not None:
            word = (self.pins.load_cell & 0xFFFFFF) << 8
            self._spi_words = [word >> 16, word & 0xFFFF]
        if len(self._spi_words) > 2:
            raise NeedleRigError("image: reads more words from the load cell than it has")
