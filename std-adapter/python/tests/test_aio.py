"""The objects for asyncio, against the virtual controller."""

import asyncio
import math
from typing import List

import pytest
import write_aio
from conftest import at_rest, eventually
from test_objects import SLOW_END

import bcap
import bcap.aio

ASIDE = bcap.J(30, 45, 90, 0, 45, 0)


def test_read_write_and_move(sim: bcap.Sim) -> None:
    async def main() -> None:
        async with bcap.aio.Controller(sim) as cell:
            await cell.write("I1", 5)
            assert await cell.read_all("I1", "I2") == [5, 0]
            async with cell.take_arm() as arm:
                await arm.motor_on()
                await arm.move(ASIDE, speed=100)
                assert (await cell.joints())[0] == pytest.approx(30)
            assert (await cell.examine()).errors == []

    asyncio.run(main())
    assert at_rest(sim)


def test_cancelling_a_motion_halts(sim: bcap.Sim) -> None:
    async def main() -> None:
        async with await bcap.aio.Controller(sim) as cell:
            async with cell.take_arm() as arm:
                await arm.motor_on()
                with pytest.raises(asyncio.TimeoutError):
                    await asyncio.wait_for(arm.move(ASIDE, speed=1), 0.3)
                assert await asyncio.to_thread(eventually, lambda: not sim.moving)
                # other calls continue while the robot moves
                await cell.execute("ClearError")
                moving = asyncio.create_task(arm.move(ASIDE, speed=1))
                assert await asyncio.to_thread(eventually, lambda: sim.moving)
                assert await cell.read("I1") == 0
                moving.cancel()

    asyncio.run(main())
    assert at_rest(sim)


def test_the_stopper_halts(sim: bcap.Sim) -> None:
    async def main() -> None:
        async with bcap.aio.Controller(sim) as cell, cell.take_arm() as arm:
            stopper = await cell.stopper()
            await arm.motor_on()
            moving = asyncio.create_task(arm.move(ASIDE, speed=1))
            assert await asyncio.to_thread(eventually, lambda: sim.moving)
            assert await stopper.halt() == "halted"
            with pytest.raises((bcap.Halted, bcap.MotionFailed)):
                await moving

    asyncio.run(main())


def test_changes(sim: bcap.Sim) -> None:
    async def main() -> None:
        async with bcap.aio.Controller(sim) as cell:
            seen = []
            async for change in cell.watch(["I1"], interval=0.005):
                seen.append(change.value)
                if len(seen) == 3:
                    break
                await cell.write("I1", len(seen))
            assert seen == [0, 1, 2]

    asyncio.run(main())


def test_slave_mode(bcap_sim: bcap.Sim) -> None:
    async def main() -> None:
        async with bcap.aio.Controller(bcap_sim) as cell, cell.take_arm() as arm:
            await arm.motor_on()
            async with arm.slave_mode(max_speed=100, max_acceleration=800) as stream:
                for number in range(100):
                    joints = list(stream.cycle.start)
                    joints[0] += 1 - math.cos(number / 100 * math.pi)
                    await stream.step(joints)
            assert stream.statistics["cycles"] >= 100

    asyncio.run(main())


def test_cancelling_the_end_of_a_stream_is_a_cancellation() -> None:
    async def main(sim: bcap.Sim) -> None:
        async with bcap.aio.Controller(sim) as cell, cell.take_arm() as arm:
            await arm.motor_on()

            async def stream() -> None:
                async with arm.slave_mode() as stream:
                    streams.append(stream)
                    await stream.finish()

            streams: List[bcap.aio.SlaveStream] = []
            streaming = asyncio.create_task(stream())
            while not (streams or streaming.done()):
                await asyncio.sleep(0.01)
            # until the end has begun
            await asyncio.sleep(0.1)
            streaming.cancel()
            with pytest.raises(asyncio.CancelledError):
                await streaming
            # the end of the block has waited for the end of the stream
            assert streams[0].statistics and not sim.slave_mode

    with bcap.sim(scenario=SLOW_END) as sim:
        asyncio.run(main(sim))


def test_waiting_for_a_value(bcap_sim: bcap.Sim) -> None:
    async def main() -> None:
        async with bcap.aio.Controller(bcap_sim) as cell:
            await cell.write("F1", 1.5)
            assert await cell.wait_for("F1", 1.5, 1) == 1.5
            with pytest.raises(bcap.InvalidArgument):
                await cell.wait_for("F1", "1.5", 5)

    asyncio.run(main())


def test_errors_are_raised_where_they_are_awaited(sim: bcap.Sim) -> None:
    async def main() -> None:
        with pytest.raises(RuntimeError, match="not connected"):
            await bcap.aio.Controller(sim).read("I1")
        with pytest.raises(bcap.NotConnected):
            await bcap.aio.Controller("tcp:127.0.0.1:1")
        async with bcap.aio.Controller(sim) as cell:
            with pytest.raises(bcap.ControllerError):
                await cell.read("NONE")

    asyncio.run(main())


def test_the_objects_are_written_from_those_of_bcap() -> None:
    assert (write_aio.PACKAGE / "aio.py").read_text() == write_aio.written(), "write it again: python tests/write_aio.py"
