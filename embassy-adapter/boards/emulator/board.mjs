// WIZnet's W5500-EVB-Pico: an RP2040, a flash with a unique id, and a W5500 at SPI0.

import { readFileSync } from 'node:fs';
import { install } from './rom.mjs';
import { Host } from './usb.mjs';
import { W5500 } from './w5500.mjs';

const FLASH = 0x10000000;
const VECTORS = 0x10000100;
const XIP_CTRL = 0x14000000;
const SSI = 0x18000000;
const ROSC = 0x40060000;

const CS = 17;
const RESET = 20;
const INT = 21;
/** The time of a byte at 30 MHz. */
const BYTE_NANOS = 267;

/** The register AIRCR, and its bit that resets the chip. */
const AIRCR = 0xd0c;
const SYSRESETREQ = 4;

/** The command of the flash, and its answer after four bytes. */
const READ_UNIQUE_ID = 0x4b;
const UNIQUE_ID = [0xe4, 0x62, 0x0c, 0x11, 0x5a, 0x01, 0x23, 0x45];

/** Copies the blocks of a UF2 file into the flash, as the boot ROM does: it takes only those for its chip. */
function loadUf2(rp2040, uf2) {
  for (let block = 0; block < uf2.length; block += 512) {
    const [first, second, flags, address, size, number, count, family] = Array.from({ length: 8 }, (_, at) => uf2.readUInt32LE(block + 4 * at));
    if (first !== 0x0a324655 || second !== 0x9e5d5157 || uf2.readUInt32LE(block + 508) !== 0x0ab16f30 || family !== 0xe48bff56) {
      throw new Error(`block ${block / 512} is not for this board`);
    }
    if (flags !== 0x2000 || size !== 256 || number !== block / 512 || count !== uf2.length / 512) {
      throw new Error(`block ${block / 512} has wrong fields`);
    }
    rp2040.flash.set(uf2.subarray(block + 32, block + 32 + size), address - FLASH);
  }
}

/** Copies a UF2 file, or the loadable segments of an ELF file, into the flash. */
function load(rp2040, file) {
  const elf = readFileSync(file);
  if (elf.toString('latin1', 0, 4) === 'UF2\n') {
    loadUf2(rp2040, elf);
    return;
  }
  const [table, size, count] = [elf.readUInt32LE(28), elf.readUInt16LE(42), elf.readUInt16LE(44)];
  for (let header = table; header < table + size * count; header += size) {
    const [offset, address, length] = [4, 12, 16].map((field) => elf.readUInt32LE(header + field));
    if (elf.readUInt32LE(header) === 1 && length > 0) {
      rp2040.flash.set(elf.subarray(offset, offset + length), address - FLASH);
    }
  }
}

/** Adds what rp2040js does not have. */
function complete(rp2040, restart) {
  install(rp2040);
  const xip = rp2040.peripherals[(XIP_CTRL >>> 14) << 2] = { readUint32: () => 0, writeUint32Atomic: () => {} };
  // the ring oscillator is stable and has a random bit
  rp2040.peripherals[(ROSC >>> 14) << 2] = { ...xip, readUint32: () => 0x80001000 + (Math.random() < 0.5 ? 0 : 1) };
  const ssi = rp2040.findPeripheral(SSI);
  const { readUint32, writeUint32 } = ssi;
  const DATA = 0x60;
  let answer = [];
  ssi.readUint32 = (offset) => (offset === DATA && answer.length > 0 ? answer.shift() : readUint32.call(ssi, offset));
  ssi.writeUint32 = (offset, value) => {
    if (offset === DATA) {
      answer = (value & 0xff) === READ_UNIQUE_ID ? [0, 0, 0, 0, ...UNIQUE_ID] : [];
    }
    writeUint32.call(ssi, offset, value);
  };
  const { ppb } = rp2040;
  const writePpb = ppb.writeUint32;
  ppb.writeUint32 = (offset, value) => (offset === AIRCR && value & SYSRESETREQ ? restart() : writePpb.call(ppb, offset, value));
  rp2040.findPeripheral(0x40058000).onWatchdogTrigger = restart;
}

function connect(rp2040, w5500) {
  rp2040.gpio[CS].addListener((state) => state === 0 && w5500.select());
  rp2040.gpio[RESET].addListener((state) => state === 0 && w5500.reset());
  const spi = rp2040.spi[0];
  let answer = 0;
  const done = rp2040.clock.createAlarm(() => spi.completeTransmit(answer));
  spi.onTransmit = (byte) => {
    answer = w5500.transfer(byte);
    done.schedule(BYTE_NANOS);
  };
}

export class Board {
  /** `frame` receives each Ethernet frame that the board sends, `serial` the number of a serial port and bytes from it. */
  constructor({ RP2040, USBCDC, ConsoleLogger, LogLevel }, images, { frame, serial }) {
    this.resets = 0;
    this.w5500 = new W5500(frame, (level) => this.rp2040.gpio[INT].setInputValue(level));
    this.start = () => {
      const before = this.rp2040;
      this.isResetting = false;
      this.rp2040 = new RP2040();
      this.rp2040.logger = new ConsoleLogger(LogLevel.Error);
      if (before) {
        // a reset keeps the memory
        this.rp2040.flash.set(before.flash);
        this.rp2040.sram.set(before.sram);
        this.resets++;
      } else {
        images.forEach((image) => load(this.rp2040, image));
      }
      complete(this.rp2040, () => (this.isResetting = true));
      this.w5500.reset();
      connect(this.rp2040, this.w5500);
      this.usb = new Host(USBCDC, this.rp2040.usbCtrl, serial);
      this.rp2040.core.VTOR = VECTORS;
      this.rp2040.core.reset();
    };
    this.start();
  }

  /** Runs one instruction, or sleeps up to the next alarm if that is at most `limit` nanoseconds away. Returns false otherwise. */
  step(limit) {
    const { core, clock } = this.rp2040;
    if (core.waiting) {
      const next = clock.nanosToNextAlarm;
      if (next > limit) {
        return false;
      }
      clock.tick(next);
    } else {
      clock.tick((core.executeInstruction() * 1e9) / this.rp2040.clkSys);
    }
    if (this.isResetting) {
      this.start();
    }
    return true;
  }
}
