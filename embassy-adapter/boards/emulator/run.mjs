// Runs an image for WIZnet's W5500-EVB-Pico:
//
//   node run.mjs IMAGE[,IMAGE] RAC,UPDATE,FIND CONSOLE >LOG
//
// The flash has one image, or a boot loader and an image; each is an ELF or UF2 file. RAC and UPDATE are local TCP ports that are forwarded
// to the ports 5006 and 5010 of the board, and FIND is a UDP port that is forwarded to 5011. CONSOLE is a Unix socket for the console of
// the board. LOG gets the bytes of the log. Lines of the standard input are faults: `fill` fills the memory of the W5500 with broadcasts,
// `damage` stores a frame in it whose length is damaged. rp2040js is searched in the directory $RP2040JS. QEMU, which runs no machine, is
// the network: it has a DHCP server, and this computer has the address 192.168.0.1 in it, where an image without settings expects its robot.

import { spawn } from 'node:child_process';
import { createRequire } from 'node:module';
import { createServer } from 'node:net';
import { createInterface } from 'node:readline';
import { Board } from './board.mjs';

const rp2040js = createRequire(`${process.env.RP2040JS}/`)('rp2040js');
const [images, ports, consolePath] = process.argv.slice(2);
const [rac, update, find] = ports.split(',');
const LOG = 1;
/** The longest time between looks at the sockets. */
const SLICE_NANOS = 5e6;
/** A board that is slower than that is slow; it does not catch up. */
const LAG_NANOS = 50e6;

let network = null;
let terminal = null;
/** The bytes of the console before the first terminal. */
const early = [];
const board = new Board(rp2040js, images.split(','), {
  frame: (frame) => {
    const length = Buffer.alloc(4);
    length.writeUInt32BE(frame.length);
    network?.write(Buffer.concat([length, frame]));
  },
  serial: (port, bytes) => (port === LOG ? process.stdout.write(bytes) : terminal ? terminal.write(bytes) : early.push(Buffer.from(bytes))),
});

/** QEMU's sockets have the length of each frame before it, in four bytes. */
function readFrames(socket) {
  network = socket;
  let received = Buffer.alloc(0);
  socket.on('data', (data) => {
    received = Buffer.concat([received, data]);
    while (received.length >= 4 && received.length >= 4 + received.readUInt32BE(0)) {
      const end = 4 + received.readUInt32BE(0);
      board.w5500.receive(received.subarray(4, end));
      received = received.subarray(end);
    }
  });
}

function startNetwork(port) {
  const hub = (id, netdev) => ['-netdev', `hubport,id=${id},hubid=0,netdev=${netdev}`];
  const qemu = spawn('qemu-system-arm', [
    ...['-M', 'none', '-display', 'none', '-monitor', 'none', '-serial', 'none'],
    ...['-netdev', `user,id=user,net=192.168.0.0/24,host=192.168.0.1,dhcpstart=192.168.0.15,hostfwd=tcp:127.0.0.1:${rac}-:5006,hostfwd=tcp:127.0.0.1:${update}-:5010,hostfwd=udp:127.0.0.1:${find}-:5011`, ...hub('a', 'user')],
    ...['-netdev', `socket,id=frames,connect=127.0.0.1:${port}`, ...hub('b', 'frames')],
  ]);
  qemu.on('exit', (code) => {
    console.error(`QEMU ended with ${code}: ${qemu.stderr.read()}`);
    process.exit(1);
  });
  const end = () => {
    qemu.removeAllListeners('exit');
    qemu.kill();
    process.exit(0);
  };
  process.on('SIGTERM', end).on('SIGINT', end);
}

const frames = createServer(readFrames).listen(0, '127.0.0.1', () => startNetwork(frames.address().port));
createServer((socket) => {
  terminal = socket;
  socket.write(Buffer.concat(early.splice(0)));
  socket.on('data', (data) => board.usb.send(data)).on('error', () => {});
}).listen(consolePath);

const broadcast = Buffer.alloc(60, 0xff);
createInterface({ input: process.stdin }).on('line', (fault) => {
  if (fault === 'fill') {
    while (board.w5500.receive(broadcast));
  } else if (fault === 'damage') {
    board.w5500.receive(broadcast, 0);
  }
});

const now = () => Number(process.hrtime.bigint());
let start = now();

/** Runs the board for a while, not faster than the time of this computer, so that the network keeps up with its timeouts. */
function run() {
  const elapsed = () => now() - start - board.rp2040.clock.nanos;
  const end = now() + SLICE_NANOS;
  for (let steps = 1; steps % 1024 !== 0 || now() < end; steps++) {
    const { resets } = board;
    if (!board.step(Math.max(elapsed(), 0))) {
      setTimeout(run, 1);
      return;
    }
    if (board.resets !== resets) {
      console.error('the board was reset');
      start = now();
    }
  }
  start += Math.max(elapsed() - LAG_NANOS, 0);
  setImmediate(run);
}
run();
