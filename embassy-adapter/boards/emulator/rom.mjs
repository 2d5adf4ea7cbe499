// What an image needs of the RP2040's boot ROM: the functions that embassy-rp calls around accesses to the flash. Each is a
// breakpoint and a return; the emulator does the work.

const FLASH = 0x10000000;
const TABLE = 0x40;
const LOOKUP = 0x80;
const FUNCTIONS = 0x100;

const bkpt = (number) => 0xbe00 | number;
const BX_LR = 0x4770;

/** Copies bytes within the memory of the chip. */
function copy(rp2040, to, from, count) {
  for (let i = 0; i < count; i++) {
    rp2040.writeUint8(to + i, rp2040.readUint8(from + i));
  }
}

const functions = {
  IF: () => {}, // connect_internal_flash
  EX: () => {}, // flash_exit_xip
  FC: () => {}, // flash_flush_cache
  CX: () => {}, // flash_enter_cmd_xip
  RE: (rp2040, [address, count]) => rp2040.flash.fill(0xff, address, address + count),
  RP: (rp2040, [address, data, count]) => {
    for (let i = 0; i < count; i++) {
      rp2040.flash[address + i] &= rp2040.readUint8(data + i);
    }
  },
  C4: (rp2040, [to, from, count]) => copy(rp2040, to, from, count), // memcpy44
};
const names = Object.keys(functions);

/** Installs the ROM. */
export function install(rp2040) {
  const rom = new DataView(rp2040.bootrom.buffer);
  const routine = (address, number) => {
    rom.setUint16(address, bkpt(number), true);
    rom.setUint16(address + 2, BX_LR, true);
  };
  rom.setUint8(0x13, 2); // version
  rom.setUint16(0x14, TABLE, true);
  rom.setUint16(0x18, LOOKUP | 1, true);
  routine(LOOKUP, names.length);
  names.forEach((_, number) => routine(FUNCTIONS + 4 * number, number));
  rp2040.onBreak = (number) => onBreak(rp2040, number);
}

function onBreak(rp2040, number) {
  const { registers } = rp2040.core;
  if (rp2040.core.PC >= FLASH) {
    throw new Error(`the image stopped at a breakpoint, PC ${rp2040.core.PC.toString(16)}`);
  }
  if (number < names.length) {
    functions[names[number]](rp2040, registers);
    return;
  }
  const name = String.fromCharCode(registers[1] & 0xff, registers[1] >> 8);
  const index = names.indexOf(name);
  if (index < 0) {
    throw new Error(`the ROM of the emulator has no function ${name}`);
  }
  registers[0] = (FUNCTIONS + 4 * index) | 1;
}
