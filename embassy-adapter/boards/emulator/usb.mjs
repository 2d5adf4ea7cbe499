// A USB host for the two serial ports of the images. Enumeration is rp2040js's. Its transfers of data are replaced: it supports
// only one port, and it completes each transfer immediately, reads without data.

const BUFFER_CONTROL = 0x80;
const BUFFER_CONTROL_END = 0x100;
const OUT = 4;
const LENGTH = 0x3ff;
const AVAILABLE = 0x400;
const FULL = 0x8000;
const PACKET = 64;
/** The time after which the host takes a packet. */
const POLL_NANOS = 100_000;

const ENDPOINT = 5;
const BULK = 2;

/** Returns the bulk endpoints of each port: `{ in, out }`. */
function ports(descriptors) {
  const found = [];
  for (let at = 0; at < descriptors.length && descriptors[at] > 0; at += descriptors[at]) {
    const [, type, address, attributes] = descriptors.slice(at, at + 4);
    if (type !== ENDPOINT || (attributes & 3) !== BULK) {
      continue;
    }
    const last = found.at(-1);
    const direction = address & 0x80 ? 'in' : 'out';
    if (last && !(direction in last)) {
      last[direction] = address & 0xf;
    } else {
      found.push({ [direction]: address & 0xf });
    }
  }
  return found;
}

export class Host {
  /** `receive` gets the number of a port and bytes from it. */
  constructor(USBCDC, usb, receive) {
    this.usb = usb;
    this.receive = receive;
    this.memory = usb.rp2040.usbDPRAMView;
    this.pending = [];
    this.enumeration = new USBCDC(usb);
    const { DPRAMUpdated } = usb;
    usb.DPRAMUpdated = (offset, value) => {
      if (offset < BUFFER_CONTROL + 8 || offset >= BUFFER_CONTROL_END) {
        DPRAMUpdated.call(usb, offset, value);
      } else if (offset & OUT) {
        this.transferOut();
      } else if (value & AVAILABLE) {
        usb.rp2040.clock.createAlarm(() => this.transferIn(offset)).schedule(POLL_NANOS);
      }
    };
  }

  get ports() {
    return ports(this.enumeration.descriptors);
  }

  /** Sends bytes to the first port. */
  send(bytes) {
    this.pending.push(...bytes);
    this.transferOut();
  }

  /** Sends the next packet if the device has a buffer for it. */
  transferOut() {
    const endpoint = this.ports[0]?.out;
    if (endpoint === undefined || this.pending.length === 0) {
      return;
    }
    const control = BUFFER_CONTROL + 8 * endpoint + OUT;
    const value = this.memory.getUint32(control, true);
    if (value & AVAILABLE) {
      const packet = this.pending.splice(0, PACKET);
      this.usb.rp2040.usbDPRAM.set(packet, this.usb.getEndpointBufferOffset(endpoint, true));
      this.memory.setUint32(control, (value & ~(AVAILABLE | LENGTH)) | FULL | packet.length, true);
      this.usb.indicateBufferReady(endpoint, true);
    }
  }

  /** Takes a packet of the device. */
  transferIn(control) {
    const endpoint = (control - BUFFER_CONTROL) >> 3;
    const value = this.memory.getUint32(control, true);
    const start = this.usb.getEndpointBufferOffset(endpoint, false);
    const packet = this.usb.rp2040.usbDPRAM.slice(start, start + (value & LENGTH));
    this.memory.setUint32(control, value & ~(AVAILABLE | FULL), true);
    this.usb.indicateBufferReady(endpoint, false);
    this.receive(this.ports.findIndex((port) => port.in === endpoint), packet);
  }
}
