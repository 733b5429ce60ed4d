"""Lines of ASCII, or binary frames, for robots without Modbus, on the same registers.

Responsible for: one request per line, one answer per line, poses in the convention of the robot's maker.
Not for connections (`lineserver`), nor for commands, turns to write and validity of results: each line
becomes a write and reads of `CellRegisters`, like those of any other client.

    7,LOCATE,0                                           sequence, command, job
    7,LOCATE,0,512.034,-88.120,611.020,12.4,3.0,178.3    with the pose of the flange
    7,LOCATE,0:2                                         only in the second box of the limits
    7,EXPOSE,0 and 8,RESULT                              LOCATE in two: the first returns after the exposure
    7,SKIP,0                                             LOCATE that puts the part shown last at the end
    8,NEXT_GRASP                                         another grasp of the part given last
    9,PLACE,0,512.034,-88.120,611.020,12.4,3.0,178.3     how to place a part that was measured in the gripper
    9,TRAY,7                                             which pockets have parts, and whether the seventh has
    7,LOCATE,0,BELT,51200,200.0,512.034,...              with count and speed of a belt; then the flange
    8,BELT and 9,COUNT                                   pose of that part on the belt; its count
    kuka,7,LOCATE,0                                      with the robot's brand
    7,0,2,412.300000,...,0.153000                        the answer, see `edged.plc.lines.LineAnswer`

A line that is repeated because its answer was lost has the same sequence, and is carried out once. A message
that begins with the first byte of a frame (`edged.plc.frames`) is read and answered as a frame.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.adapters.modbus.cell import ClientView
from edged.adapters.modbus.pdu import RequestRefused
from edged.adapters.modbus.settings import LineSettings, ModbusSettings
from edged.domain.arrays import FloatArray
from edged.domain.events import REGISTERING, CommandKind
from edged.domain.measurement import Reject
from edged.domain.numerals import decimal, whole
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.frames import COMMANDS, MAGIC, read_request
from edged.plc.lines import POSE_NAMES, UNKNOWN, BadRequest, LineAnswer, LineStatus
from edged.robot.grasping import place_correction
from edged.robot.orientations import ANGLES_DEG, Brand, pose_of, rotation_of, transform_of
from edged.vision.geometry.rigid import transform

TIMEOUT_S = 10.0
"""Time-out of a command, after which the cell answers NACK, TIMEOUT."""
LOOK_S = 0.05
"""Poll period while waiting for the end of a command, which a time-out may end without any event."""
TOOLS = ("GRASP", "APPROACH")
"""Queries about the grasp of the part given last."""
NEXT = {"NEXT_PART": LineStatus.NO_FURTHER, "NEXT_GRASP": LineStatus.NO_GRASP}
"""Commands that take no picture, and their status when there is no next part or grasp."""
OFFSETS = {"OFFSET": "O", "OFFSET_PART": "OP"}
"""Queries about the offset of that part from the golden one, and the prefix of their registers."""
QUALITY = ("RMS", "HELD_OUT", "LIMIT")
"""Lengths in the answer to a registration command, in place of X, Y, Z."""
WANTED = {"VERIFY": reg.ResultCode.VERIFIED, "GOLDEN": reg.ResultCode.KEPT}
"""Expected RESULT of commands that are not answered with a pose."""
BELT = "BELT"
"""Keyword before count and speed in a request; also the query for the pose on the belt."""
ON_BELT = ("LOCATE", "EXPOSE", "SKIP", "VERIFY", "GOLDEN")
"""Commands that may state count and speed of a conveyor belt."""
FORBIDDEN = Reject.OUT_OF_LIMITS | Reject.KEEP_OUT | Reject.NO_GRASP | Reject.OUT_OF_MAP


class _Refused(Exception):
    """Request that is answered with this status."""

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(f"status {status}")


@dataclass(frozen=True, slots=True)
class LineRequest:
    """A decoded line or frame.

    brand : of the robot. flange : robot_from_flange (4, 4) in mm, None if not given. shown : its numbers as
    written. tries_all : the job was "*". box : number of the only box to use; 0: by the register BOX.
    belt : BELT_COUNT and BELT_SPEED; None: not given.
    """

    brand: Brand
    sequence: int
    command: str
    job: int
    flange: FloatArray | None
    tries_all: bool = False
    shown: tuple[float, ...] = ()
    box: int = 0
    belt: tuple[int, int] | None = None


BLANKS = " \t\r\n"
BRAND_WORDS = {str(brand): brand for brand in Brand}


def parse(line: bytes, configured: Brand) -> LineRequest:
    """Decode a line. configured : brand of a request without one. Raises `BadRequest`."""
    fields = [field.strip(BLANKS) for field in line.decode("ascii", "replace").split(",")]
    brand = BRAND_WORDS.get(fields[0].lower())
    try:
        if brand is None and fields[0].isalpha() and len(fields) > 2:
            status, sequence = LineStatus.NO_SUCH_BRAND, whole(fields[1])
            raise BadRequest(f"no such brand: {fields[0]}", configured, status, sequence)
        return _request(fields if brand is None else fields[1:], brand or configured)
    except (ValueError, OverflowError) as error:
        if isinstance(error, BadRequest):
            raise
        raise BadRequest(str(error), brand or configured) from error


def _request(fields: list[str], brand: Brand) -> LineRequest:
    """Decode the fields after the brand. Raises ValueError, OverflowError."""
    if len(fields) < 2:
        raise ValueError("expected a sequence and a command")
    sequence, command = whole(fields[0]), fields[1].upper()
    which, colon, narrowed = fields[2].partition(":") if len(fields) > 2 else ("0", "", "")
    tries_all = which == "*"
    job, box = 0 if tries_all else whole(which), whole(narrowed) if colon else 0
    if not 1 <= sequence <= 0xFFFF or not 0 <= job <= 0xFFFF or not 0 <= box <= 0xFFFF:
        raise ValueError("sequences are 1 to 65535, jobs and boxes 0 to 65535")
    command = "NEXT_PART" if command == "NEXT" else command
    if command not in COMMANDS:
        raise ValueError(f"no such command: {command}")
    numbers, belt = fields[3:], None
    if numbers and numbers[0].upper() == BELT and command in ON_BELT:
        belt, numbers = _belt(numbers[1:3], brand), numbers[3:]
    shown = tuple(decimal(field) for field in numbers)
    flange = transform_of(brand, shown) if shown else None
    return LineRequest(brand, sequence, command, job, flange, tries_all, shown, box, belt)


def _belt(fields: list[str], brand: Brand) -> tuple[int, int]:
    """Decode BELT_COUNT and BELT_SPEED, whose unit is the brand's length per second. Raises ValueError."""
    if len(fields) < 2:
        raise ValueError("expected the belt's count and its speed")
    count, speed_um_s = whole(fields[0]), decimal(fields[1]) * (1e6 if brand is Brand.UR else 1e3)
    if count > reg.UINT32_MAX or not 0.0 <= speed_um_s <= reg.UINT32_MAX:
        raise ValueError("a count or speed that fits no register")
    return count, round(speed_um_s)


def parse_frame(frame: bytes, configured: Brand) -> LineRequest:
    """Decode a frame. configured : brand of a request without one. Raises `BadRequest`."""
    asked = read_request(frame, configured)
    brand = asked.brand or configured
    try:
        if asked.sequence == 0:
            raise ValueError("sequences are 1 to 65535")
        flange = transform_of(brand, asked.flange) if asked.flange else None
    except (ValueError, OverflowError) as error:
        raise BadRequest(str(error), brand) from error
    return LineRequest(
        brand, asked.sequence, asked.command, asked.job, flange, asked.tries_all, asked.flange, asked.box
    )


class Robot:
    """Carries out the requests of one connection.

    _sequence : CMD_SEQ of its newest command. _asked : the robot's sequence of that command, and its name if
    it is one of `NEXT`. _located : the robot's sequence of the last command that is not one of `NEXT`.
    _given : the robot's sequences since then, including that one.
    """

    def __init__(
        self, view: ClientView, settings: ModbusSettings, line: LineSettings, *, may_write: bool
    ) -> None:
        self._view = view
        self._settings = settings
        self._line = line
        self._may_write = may_write
        self._sequence = 0
        self._asked = (0, "")
        self._located = 0
        self._given: set[int] = set()

    async def answer(self, message: bytes) -> tuple[LineAnswer, Brand]:
        """Carry out a line or frame; return the answer and the brand to format it for.

        Never raises, whatever the robot sent.
        """
        read = parse_frame if message.startswith(MAGIC[:1]) else parse
        request: LineRequest | BadRequest
        try:
            request = read(message, self._line.brand)
        except BadRequest as error:
            request = error
        if not self._may_write:
            answer = LineAnswer(0, LineStatus.MAY_NOT_WRITE)
        elif isinstance(request, BadRequest):
            answer = LineAnswer(request.sequence, request.status)
        else:
            answer = await self._answered(request)
        return answer, request.brand

    async def _answered(self, request: LineRequest) -> LineAnswer:
        try:
            return await self._carry_out(request)
        except _Refused as refused:
            return LineAnswer(request.sequence, refused.status)
        except RequestRefused:
            return LineAnswer(request.sequence, LineStatus.NOT_YOUR_TURN)
        except OverflowError:  # a flange beyond what a register holds
            return LineAnswer(request.sequence, LineStatus.NOT_UNDERSTOOD)

    async def _carry_out(self, request: LineRequest) -> LineAnswer:
        if request.command == "ACK":
            # after several NEXT, acknowledging any of their sequences acknowledges the part on display
            used = self._sequence if request.sequence in self._given else request.sequence
            self._write("ACK_SEQ", [used])
            return LineAnswer(request.sequence, LineStatus.OK)
        if request.command == "AUTO_LOCK":
            self._write("AUTO_LOCK", [request.job])
            return LineAnswer(request.sequence, LineStatus.OK)
        if request.command in TOOLS:
            return self._tool(request)
        if request.command in OFFSETS:
            return self._offset(request)
        if request.command == "PLACE":
            return self._place(request)
        if request.command == "TRAY":
            return self._tray(request)
        if request.command == BELT:
            result = self._on_belt()
            return self._answer(request, result, [result[f"B_{axis}"] for axis in "XYZABC"], "B_SIGMA")
        if request.command == "COUNT":
            return self._count(request)
        if request.command in NEXT:
            return await self._next(request)
        if CommandKind.__members__.get(request.command) in REGISTERING:
            return await self._register(request)
        if request.command == "RESULT":
            if self._sequence == 0:
                raise _Refused(LineStatus.NOT_VALID)
            self._given.add(request.sequence)
            await self._end()
        else:
            await self._locate(request)
        if request.command == "EXPOSE":
            return LineAnswer(request.sequence, LineStatus.OK)
        result = self._read(reg.RESULT)
        code = int(result["RESULT"])
        reject = int(result["REJECT"])
        if code == reg.ResultCode.LOW_QUALITY and reject and not reject & ~FORBIDDEN:
            raise _Refused(LineStatus.OUT_OF_LIMITS)
        if request.command in ("LOCATE", "RESULT", "SKIP"):
            if code != reg.ResultCode.OK:
                raise _Refused(100 + code)
            return self._part(request, LineStatus.NOT_VALID, result)
        if code != WANTED.get(request.command, code):
            raise _Refused(100 + code)
        return LineAnswer(request.sequence, LineStatus.OK)

    async def _locate(self, request: LineRequest) -> None:
        """Carry out any command but those of `NEXT`, under the robot's sequence."""
        shown = self._view.echo
        if self._asked != (request.sequence, "") or shown != self._sequence:
            if shown == request.sequence:
                # the same number from another client, or from NEXT: its answer is not this command's
                self._write("CMD_SEQ", [0])
            self._begin(request, request.sequence)
            self._located, self._given = request.sequence, {request.sequence}
            await asyncio.sleep(0)  # the cycle begins before this looks whether it has ended
        await self._end(at_exposure=request.command == "EXPOSE")

    async def _next(self, request: LineRequest) -> LineAnswer:
        """Answer with the next part of the picture, or grasp, under a sequence of our own that cannot clash.

        With the sequence of the LOCATE, each line is a new request; with a sequence of its own, it may be
        repeated.
        """
        at_end = NEXT[request.command]
        shown = self._view.echo
        if self._sequence == 0 or shown != self._sequence:
            raise _Refused(at_end)  # another client's list of parts must not be used
        if self._asked != (request.sequence, request.command) or request.sequence == self._located:
            self._begin(request, shown % 0xFFFF + 1)
            self._given.add(request.sequence)
        try:
            await self._end()
        except _Refused as refused:
            is_end = refused.status == NackReason.NO_LIST
            raise _Refused(at_end if is_end else refused.status) from None
        return self._tool(request) if at_end is LineStatus.NO_GRASP else self._part(request, at_end)

    async def _register(self, request: LineRequest) -> LineAnswer:
        """Carry out a registration command; the answer has the registration's state instead of a pose.

        That holds for a refused command, too.
        """
        status: int = LineStatus.OK
        try:
            await self._locate(request)
        except _Refused as refused:
            status = refused.status
        state = self._read(reg.REGISTRATION)
        if state["H_SEQ"] != self._sequence:
            raise _Refused(status)
        to_unit = 1e-6 if request.brand is Brand.UR else 1e-3  # from µm
        lengths = (float(state[f"H_{name}"]) for name in QUALITY)
        known = [length * to_unit if length != reg.INT32_MIN else UNKNOWN for length in lengths]
        numbers = (*known, float(state["H_USED"]), float(state["H_WORST"]))
        blank = (0.0,) * (len(POSE_NAMES[request.brand]) - len(numbers))
        sigmas = self._sigma(state, "H_SIGMA", request.brand)
        return LineAnswer(request.sequence, status, int(state["H_SAMPLES"]), (*numbers, *blank), sigmas)

    def _begin(self, request: LineRequest, sequence: int) -> None:
        start = self._settings.base_address + reg.ADDRESS["COMMAND"]
        beside = {"BOX": request.box} if request.box else {}
        if request.belt is not None:
            beside |= dict(zip(("BELT_COUNT", "BELT_SPEED"), request.belt, strict=True))
        before = self._read(reg.COMMAND) if beside else {}
        self._put(beside)
        try:
            self._view.write(start, self._command(request, sequence), shown=request.shown)
        finally:  # they apply to this command only
            self._put({name: before[name] for name in beside})
        self._sequence = sequence
        self._asked = (request.sequence, request.command if request.command in NEXT else "")

    async def _end(self, *, at_exposure: bool = False) -> None:
        """Wait for the end of the command, or only until its picture is taken."""
        sequence = self._sequence
        loop = asyncio.get_running_loop()
        end_s = loop.time() + TIMEOUT_S + 1.0
        while loop.time() < end_s:
            status = self._read(reg.STATUS)
            if status["CMD_SEQ_ECHO"] != sequence:
                raise _Refused(LineStatus.TAKEN_OVER)
            bits = int(status["STATUS_BITS"])
            if at_exposure and bits & reg.StatusBit.EXPOSURE_DONE:
                return
            if status["DONE_SEQ"] == sequence:
                if bits & reg.StatusBit.NACK:
                    raise _Refused(int(status["NACK_REASON"]))
                if bits & reg.StatusBit.ACK:
                    return
            await self._view.change(LOOK_S)
        raise _Refused(LineStatus.TAKEN_OVER)

    def _command(self, request: LineRequest, sequence: int) -> list[int]:
        """Words from COMMAND to TIMEOUT; later words, which a PLC may have written, stay unchanged.

        Option ONCE is set, as a line writes its command only once.
        """
        kind = CommandKind.LOCATE if request.command in ("EXPOSE", "SKIP") else CommandKind[request.command]
        options = reg.Option.ONCE | (reg.Option.ALL_JOBS if request.tries_all else reg.Option(0))
        options |= reg.Option.SKIP if request.command == "SKIP" else reg.Option(0)
        options |= reg.Option.BELT if request.belt is not None else reg.Option(0)
        values: dict[str, reg.Number] = {
            "COMMAND": kind,
            "JOB": request.job,
            "CMD_SEQ": sequence,
            "OPTIONS": options,
            "TIMEOUT": round(TIMEOUT_S * 1000),
            **{f"FLANGE_{axis}": 0 for axis in "XYZABC"},
        }
        if request.flange is not None:
            angles = ANGLES_DEG[self._settings.convention](request.flange[:3, :3])
            numbers = (*request.flange[:3, 3].tolist(), *angles)
            pairs = zip("XYZABC", numbers, strict=True)
            values |= {f"FLANGE_{axis}": round(number * 1000) for axis, number in pairs}
        return self._words(values)[: reg.ADDRESS["TIMEOUT"] - reg.COMMAND.address + 1]

    def _part(
        self, request: LineRequest, otherwise: LineStatus, shown: dict[str, reg.Number] | None = None
    ) -> LineAnswer:
        """Answer with the part on display. otherwise : status if it is no longer valid. shown : as read."""
        result = self._usable(otherwise, shown)
        return self._answer(request, result, [result[axis] for axis in "XYZABC"], "SIGMA")

    def _tool(self, request: LineRequest) -> LineAnswer:
        """Answer with the grasp or approach of the part on display."""
        result, grasp = self._usable(LineStatus.NOT_VALID), self._read(reg.GRASP)
        if not int(grasp["G_FLAGS"]) & reg.Flag.VALID:
            raise _Refused(LineStatus.NO_GRASP)
        place = "G_APPROACH" if request.command == "APPROACH" else "G"
        pose = [*(grasp[f"{place}_{axis}"] for axis in "XYZ"), *(grasp[f"G_{axis}"] for axis in "ABC")]
        return self._answer(request, {**result, **grasp}, pose, "G_SIGMA")

    def _offset(self, request: LineRequest) -> LineAnswer:
        """Answer with the offset of the part on display; the sigmas are those of the part's place."""
        place = OFFSETS[request.command]
        values, numbers = self._offset_numbers(place)
        return self._answer(request, values, numbers, f"{place}_SIGMA")

    def _place(self, request: LineRequest) -> LineAnswer:
        """Answer with the correction of a taught place (a factor from the right) for a part in the gripper.

        The request states the pose of the tool at this LOCATE and at GOLDEN.
        """
        if request.flange is None:
            raise _Refused(LineStatus.NOT_UNDERSTOOD)
        values, numbers = self._offset_numbers(OFFSETS["OFFSET"])
        x, y, z, a, b, c = (number / 1000 for number in numbers)
        offset = transform(rotation_of(self._settings.convention, a, b, c), np.array([x, y, z]))
        answer = self._answer(request, values, numbers, "O_SIGMA")
        turned = pose_of(request.brand, place_correction(offset, request.flange))
        return replace(answer, pose=turned, sigma=(UNKNOWN,) * 3)

    def _offset_numbers(self, place: str) -> tuple[dict[str, reg.Number], list[float]]:
        """Values of the blocks result and offset, and the offset's X Y Z A B C in µm and 0.001°."""
        result, offset = self._usable(LineStatus.NOT_VALID), self._read(reg.OFFSET)
        if not int(offset["O_FLAGS"]) & reg.Flag.VALID:
            raise _Refused(LineStatus.NO_OFFSET)
        numbers = [float(offset[f"{place}_{axis}"]) for axis in "XYZ"]
        # these angles have one more digit: a metre from the base, 0.0001° is 2 µm
        numbers += [float(offset[f"{place}_{axis}"]) / 10 for axis in "ABC"]
        return {**result, **offset}, numbers

    def _tray(self, request: LineRequest) -> LineAnswer:
        """Answer with the state of the tray in place of a pose, also for a tray without parts."""
        result, tray = self._read(reg.RESULT), self._read(reg.TRAY)
        pockets, is_mine = int(tray["P_POCKETS"]), tray["P_SEQ_HEAD"] == self._sequence != 0
        if not is_mine or not pockets or request.job > pockets:
            raise _Refused(LineStatus.NO_TRAY)
        if int(result["FLAGS"]) & reg.Flag.SIMULATED and not self._line.allow_simulated:
            raise _Refused(LineStatus.SIMULATED)
        word, bit = divmod(max(request.job, 1) - 1, 16)
        is_taken = int(tray[f"P_PARTS_{word + 1}"]) >> bit & 1 if request.job else 0
        numbers = (tray["POCKET"], tray["P_TAKEN"], tray["P_FIRST_EMPTY"], pockets, is_taken)
        pose = [*map(float, numbers), *(0.0,) * (len(POSE_NAMES[request.brand]) - len(numbers))]
        return LineAnswer(request.sequence, LineStatus.OK, int(result["REMAINING"]), tuple(pose))

    def _on_belt(self) -> dict[str, reg.Number]:
        """Values of the result on display and of the block belt, if a robot may move by them."""
        result, belt = self._usable(LineStatus.NOT_VALID), self._read(reg.BELT)
        if not int(belt["B_FLAGS"]) & reg.Flag.VALID:
            raise _Refused(LineStatus.NO_BELT)
        return {**result, **belt}

    def _count(self, request: LineRequest) -> LineAnswer:
        """Answer with the count of the pose in the belt's frame, in place of a pose.

        It is in halves of 16 bits, as a robot's REAL cannot hold 32.
        """
        result = self._on_belt()
        high, low = divmod(int(result["B_COUNT"]), 1 << 16)
        speed = float(result["B_SPEED"]) * (1e-6 if request.brand is Brand.UR else 1e-3)
        numbers = (float(high), float(low), speed, float(result["B_PART"]))
        pose = (*numbers, *(0.0,) * (len(POSE_NAMES[request.brand]) - len(numbers)))
        return LineAnswer(request.sequence, LineStatus.OK, int(result["REMAINING"]), pose)

    def _usable(
        self, otherwise: LineStatus, shown: dict[str, reg.Number] | None = None
    ) -> dict[str, reg.Number]:
        """Values of the result on display, if a robot may move by it. otherwise : status if not valid.

        shown : these values, if they were read in this turn of the loop.
        """
        result = self._read(reg.RESULT) if shown is None else shown
        flags = int(result["FLAGS"])
        if self._sequence == 0 or result["SEQ_HEAD"] != self._sequence or not flags & reg.Flag.VALID:
            raise _Refused(otherwise)
        if not flags & reg.Flag.ROBOT_FRAME:
            raise _Refused(LineStatus.RIG_FRAME)
        if flags & reg.Flag.SIMULATED and not self._line.allow_simulated:
            raise _Refused(LineStatus.SIMULATED)
        return result

    def _answer(
        self,
        request: LineRequest,
        result: Mapping[str, reg.Number],
        numbers: Sequence[reg.Number],
        sigma: str,
    ) -> LineAnswer:
        """Answer with a pose. numbers : X Y Z A B C as in the registers. sigma : prefix of the sigmas."""
        x, y, z, a, b, c = (float(number) / 1000 for number in numbers)
        robot_from_pose = transform(rotation_of(self._settings.convention, a, b, c), np.array([x, y, z]))
        pose = pose_of(request.brand, robot_from_pose)
        age_s = float(self._read(reg.STATUS)["RESULT_AGE"]) / 1000
        remaining, sigmas = int(result["REMAINING"]), self._sigma(result, sigma, request.brand)
        return LineAnswer(request.sequence, LineStatus.OK, remaining, pose, sigmas, age_s)

    def _sigma(self, result: Mapping[str, reg.Number], name: str, brand: Brand) -> tuple[float, ...]:
        """Sigmas of X, Y, Z in the brand's unit."""
        to_unit = 1e-7 if brand is Brand.UR else 1e-4  # from 0.1 µm
        known = (float(result[f"{name}_{axis}"]) for axis in "XYZ")
        return tuple(sigma * to_unit if sigma != reg.UINT16_MAX else UNKNOWN for sigma in known)

    def _read(self, block: reg.Block) -> dict[str, reg.Number]:
        words = self._view.read(self._settings.base_address + block.address, block.words)
        return reg.decode(block, words, self._settings.word_order)

    def _put(self, values: Mapping[str, reg.Number]) -> None:
        """Write those of BOX, and BELT_COUNT with BELT_SPEED, that are in `values`."""
        if not values:
            return
        words = self._words(values)
        for name, count in (("BOX", 1), ("BELT_COUNT", 4)):
            at = reg.ADDRESS[name] - reg.COMMAND.address
            if name in values:
                self._write(name, words[at : at + count])

    def _words(self, values: Mapping[str, reg.Number]) -> list[int]:
        """Words of the command block, in the configured word order."""
        data = reg.encode(reg.COMMAND, values, self._settings.word_order)
        return list(struct.unpack(f">{reg.COMMAND.words}H", data))

    def _write(self, name: str, words: list[int]) -> None:
        self._view.write(self._settings.base_address + reg.ADDRESS[name], words)
