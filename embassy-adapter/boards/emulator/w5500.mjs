// A model of WIZnet's W5500 with one socket in MACRAW mode. Frames that do not fit are dropped.
// Names and numbers of registers are those of the data sheet.

const BUFFER = 16 * 1024;

// blocks of registers and memory: the upper five bits of the control byte
const COMMON = 0;
const SOCKET = 1;
const TX_BUFFER = 2;
const RX_BUFFER = 3;
const BLOCKS = [COMMON, SOCKET, TX_BUFFER, RX_BUFFER];

// common registers
const MR = 0x00;
const SHAR = 0x09;
const SIMR = 0x18;
const PHYCFGR = 0x2e;
const VERSIONR = 0x39;

// registers of the socket
const SN_MR = 0x00;
const SN_CR = 0x01;
const SN_IR = 0x02;
const SN_SR = 0x03;
const SN_TX_FSR = 0x20;
const SN_TX_RD = 0x22;
const SN_TX_WR = 0x24;
const SN_RX_RSR = 0x26;
const SN_RX_RD = 0x28;
const SN_IMR = 0x2c;

const OPEN = 0x01;
const CLOSE = 0x10;
const SEND = 0x20;
const MACRAW = 0x04;
const SOCK_MACRAW = 0x42;
const MAC_FILTER = 0x80;
const RECEIVED = 0x04;

export class W5500 {
  /** `send` receives each frame that the chip sends; `interrupt` the level of the pin INT, true for high. */
  constructor(send, interrupt) {
    this.send = send;
    this.interrupt = interrupt;
  }

  reset() {
    this.blocks = { [COMMON]: Buffer.alloc(0x40), [SOCKET]: Buffer.alloc(0x30), [TX_BUFFER]: Buffer.alloc(BUFFER), [RX_BUFFER]: Buffer.alloc(BUFFER) };
    this.common = this.blocks[COMMON];
    this.socket = this.blocks[SOCKET];
    this.common[VERSIONR] = 4;
    this.common[PHYCFGR] = 0xbf; // link up, 100 Mbit/s, full duplex
    this.isOpen = false;
    this.received = 0; // the position after the last received frame
    this.header = [];
    this.update();
  }

  /** The pin SCS: a low level begins a transfer. */
  select() {
    this.header = [];
  }

  /** Exchanges a byte over SPI. */
  transfer(byte) {
    if (this.header.length < 3) {
      this.header.push(byte);
      return 0;
    }
    const [high, low, control] = this.header;
    const block = control >> 3;
    const address = (high << 8) | low;
    const next = (address + 1) & 0xffff;
    this.header = [next >> 8, next & 0xff, control];
    if (!BLOCKS.includes(block)) {
      return 0;
    }
    if (control & 4) {
      this.write(block, address, byte);
      return 0;
    }
    return this.blocks[block][address % BUFFER] ?? 0;
  }

  write(block, address, byte) {
    if (block === COMMON && address === MR) {
      if (byte & 0x80) {
        this.reset();
      }
    } else if (block === SOCKET && address === SN_CR) {
      this.command(byte);
    } else if (block === SOCKET && address === SN_IR) {
      this.socket[SN_IR] &= ~byte;
      this.update();
    } else if (!this.isReadOnly(block, address)) {
      this.blocks[block][address % BUFFER] = byte;
      this.update();
    }
  }

  isReadOnly(block, address) {
    const isStatus = address === SN_SR || (address >= SN_TX_FSR && address < SN_TX_WR);
    return (block === COMMON && address === VERSIONR) || (block === SOCKET && isStatus);
  }

  command(command) {
    if (command === OPEN) {
      this.isOpen = (this.socket[SN_MR] & 0x0f) === MACRAW;
      this.received = 0;
      [SN_TX_RD, SN_TX_WR, SN_RX_RD].forEach((pointer) => this.socket.writeUInt16BE(0, pointer));
    } else if (command === CLOSE) {
      this.isOpen = false;
    } else if (command === SEND && this.isOpen) {
      this.sendFrame();
    }
    this.socket[SN_SR] = this.isOpen ? SOCK_MACRAW : 0;
    this.update();
  }

  sendFrame() {
    const from = this.socket.readUInt16BE(SN_TX_RD);
    const to = this.socket.readUInt16BE(SN_TX_WR);
    const frame = Buffer.alloc((to - from) & 0xffff);
    for (let i = 0; i < frame.length; i++) {
      frame[i] = this.blocks[TX_BUFFER][(from + i) % BUFFER];
    }
    this.socket.writeUInt16BE(to, SN_TX_RD);
    this.send(frame);
  }

  /** A frame from the network, with the length before it that the chip stores. Returns whether it is kept. */
  receive(frame, length = frame.length + 2) {
    if (!this.isOpen || !this.accepts(frame) || this.unread() + frame.length + 2 > BUFFER) {
      return false;
    }
    const stored = Buffer.concat([Buffer.from([length >> 8, length & 0xff]), frame]);
    for (const byte of stored) {
      this.blocks[RX_BUFFER][this.received % BUFFER] = byte;
      this.received = (this.received + 1) & 0xffff;
    }
    // one interrupt for all frames until it is cleared; the data sheet does not say that frames that are left set it again
    this.socket[SN_IR] |= RECEIVED;
    this.update();
    return true;
  }

  accepts(frame) {
    const isForThis = frame.subarray(0, 6).equals(this.common.subarray(SHAR, SHAR + 6));
    return !(this.socket[SN_MR] & MAC_FILTER) || isForThis || (frame[0] & 1) === 1;
  }

  unread() {
    return (this.received - this.socket.readUInt16BE(SN_RX_RD)) & 0xffff;
  }

  /** Updates what follows from other registers. Frames are sent at once, so the transmit buffer is always free. */
  update() {
    this.socket.writeUInt16BE(BUFFER, SN_TX_FSR);
    this.socket.writeUInt16BE(this.unread(), SN_RX_RSR);
    const isPending = (this.socket[SN_IR] & this.socket[SN_IMR]) !== 0 && (this.common[SIMR] & 1) !== 0;
    this.interrupt(!isPending);
  }
}
