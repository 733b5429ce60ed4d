# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = 跳到正文
nav = 页面
nav-run = 运行
nav-setup = 设置
nav-jobs = 作业
nav-cycles = 循环
nav-marks = 标记
nav-accept = 验收
nav-space = 3D
nav-settings = 参数设置
nav-system = 系统
nav-manual = 手册
menu = 账户和语言：
language = 语言
log-out = 退出登录
steps = 直到抓取工件的各个步骤
step-of = 第 { $number } 步，共 { $count } 步：
foot = 上一步和下一步
understood = 知道了
back = 返回
left = 左
right = 右
state-starting = 启动中
state-ready = 就绪
state-busy = 忙
state-fault = 故障
state-stopping = 停止中
state-setup = 设置中
state-setup-by = { $name } 设置中
state-setup-nobody = 设置中
plc-locked = AUTO_LOCK：产线正在使用本单元
plc-owner = PLC
plc-nobody = 未连接 PLC
connection-lost = 与单元的连接已断开，正在重试
field-limits = { $low } 到 { $high } { $unit } 之间的数值
field-number = 一个数值，例如 0.5 或 0,5

## Steps
step-welcome = 开始
step-cameras = 相机
step-light = 光照和对焦
step-calibrate = 标定
step-check = 检查
step-teach = 示教
step-try = 试运行
step-robot = 机器人
step-plc = PLC 和投运
state-tick = 已完成
state-doubt = 需复查
state-gap = 缺失
state-open = 未开始
state-none = 此处未知

## Who has the cell
lease = 谁占用单元
lease-free = 单元正在为产线测量。要使用其相机，请先接管单元：在您归还之前，它不再响应任何 PLC。
lease-incomplete = 单元还不能测量。请接管后进行设置。
lease-locked = 产线正在使用本单元（AUTO_LOCK 为 1），任何人都不能接管。请先将产线切换到手动模式。
lease-yours = 单元由您占用。归还之前，它不为产线测量。
lease-elsewhere = 您在另一个屏幕上占用着单元。在此继续后，那个屏幕只能查看。
lease-others = { $name } 占用着单元。您实时看到相同的图像和数值。
lease-others-view = { $name } 占用着单元。您实时看到相同的图像和数值；只有工程师可以更改。
lease-view = 您可以查看全部内容。只有工程师可以更改。
lease-unattended = 单元无人看管。在有人确认内部无人之前，它不会测量。
lease-take = 接管单元
lease-take-over = 接过来
lease-continue = 在此继续
lease-leave = 归还
lease-end = 结束设置
idle = { $name }，您已有十分钟没有操作，现在只能查看。请输入密码以继续。
idle-wake = 我在
confirm-title = 请输入密码
confirm = { $name }，这会更改人员权限或单元运行所用的数据。请输入密码以继续。
confirm-yes = 继续
password = 密码
ask-take-title = 接管单元？
ask-take = 单元完成当前循环后 READY 变为 0：在您归还之前，PLC 的所有命令都会被拒绝。
ask-take-yes = 接管
ask-over-title = 从 { $name } 处接过单元？
ask-over = { $name } 会收到通知，此后只能查看。审计日志会记录此事。
ask-over-yes = 接过来
ask-leave-title = 归还单元？
ask-leave = 恢复生效的设置，拍一对测试图像，然后单元 READY。单元内不得有人，也不得留有标定板。
ask-leave-yes = 归还
ask-end-title = 单元内无人吗？
ask-end = 仅在您亲自查看后确认：单元随后 READY，产线可能启动。
ask-end-yes = 我已查看：里面没有人

## What went wrong: cause and remedy
problem-other = 未成功：{ $detail }
problem-unreachable = 单元没有应答。请检查网线和单元电脑；页面会自动重试。
problem-page = 无法加载此页面。单元恢复应答后请重新加载。
problem-log-in = 您已退出登录。请重新登录。
problem-origin = 浏览器没有说明请求来自哪个页面。请用页面自身的地址打开。
problem-setup-refused = 现在无法进行：{ $detail }
problem-lease-lost = 单元已不由您占用：上面一行显示占用者。此前所做的都已保存。
problem-lease = 单元已不由您占用：上面一行显示占用者。此前所做的都已保存。
problem-role = 您的角色无此权限。工程师可以执行。
problem-idle = 您已有十分钟没有操作。请再次输入密码。
problem-password = 密码错误。
problem-confirm = 需要再次输入您的密码。
problem-weak-password = 此密码太容易被猜到。请使用由多个单词组成、不含姓名的密码。
problem-exists = 已有人使用此名称，或看起来相同的名称。
problem-wait = 尝试次数过多。请等待 { $wait_s } 秒。
problem-invalid = 单元不接受：{ $detail }
problem-unknown = 不存在，或已不存在。请重新加载页面。
problem-input = 单元不接受：{ $detail }
problem-storage = 单元电脑的磁盘已满。请释放空间后重试。
problem-stale = 其间已被他人或在另一屏幕上更改。现在显示的是较新的内容：请检查后再做更改。
problem-regression = 这会使已记录的良好循环变差，或尚未用它们测试。请在“循环”页面测试，并从那里启用。
problem-teach-name = 不能用作名称：请用字母、数字、“_”、“.”和“-”，并以字母或数字开头。
problem-teach-name-taken = 已有作业 { $name }：请修改它，或另选名称。
problem-teach-number-taken = { $number } 是 { $name } 的编号；{ $free } 可用。
problem-teach-name-old = 以此结尾的名称属于已被替换的作业：请另选名称。
problem-image-size =
    { $side ->
        [left] 左
       *[right] 右
    }图像为 { $found } 像素，而标定为 { $wanted }：请让相机恢复该尺寸，或按现状重新标定。
problem-task-failed = 单元未能完成。若再次出现，请查看其日志(journalctl -u edged)。
problem-task-too-large = 所需内存或计算量超出单元允许的范围，已停止：请减少或缩小图像，或使用较小的图纸。
problem-gone = 此图像已不再保存。请重新拍摄。
problem-status-404 = 本单元不提供此功能。请更新单元电脑上的 edged，然后重新加载页面。
problem-status-500 = 单元内部错误：请查看其日志(journalctl -u edged)。

## Live pictures
live-left = 左相机，实时
live-right = 右相机，实时
live-waiting = 等待第一张图像。
live-watching = 占用单元的人查看相机时，这里会出现图像。
live-take = 没有图像：请接管单元以查看相机。

## On several pages
fact-rig = 标定
fact-jobs = 作业
keep-what = 这只是试用：归还单元时恢复原设置，除非您保存。
keep-calibrate = 这些相机只是试用。标定是用原来的相机做的：请重新标定，两者会一起成为单元的设置。
keep = 保存
kept = 已保存。
board-title = 哪种标定板？
board-recognise = 从图像中识别
board-state = 我来指定
board-kind = 类型
kind-chessboard = 棋盘格
kind-charuco = ChArUco
kind-dots = 圆点板
kind-circles = 非对称圆点
board-columns = 每行内角点（或圆点）数
board-rows = 行数
board-marker = 标记边长
board-dictionary = 标记字典
board-mm = 方格边长
board-pitch = 点间距
board-goal = 目标：测量空间内一点 ±
board-proof = 请用卡尺跨多个方格测量长度。图像无法验证它，而每个坐标都随它缩放。
board-begin = 开始
board-begin-auto = 开始并自动采集视图
board-still = 标定板已静止。
board-moves = 请让标定板静止片刻。
view = 视图 { $name }

## What becomes a release, and who signs for it
release-note = 原因（供以后查看的人了解）
release-making = 请稍候 …
sign-worse = { $count } 个原本良好的已记录循环会变差。
sign-untried = 尚未在相关的 { $count } 个已记录循环上测试。
sign-look = 查看
sign-try = 用它们测试
sign-what = 如果确有此意，请说明原因：它会随版本保存，并与您的姓名一起记入审计日志。
sign-reason = 为何可以接受
sign = 签署：{ $label }

## The virtual stage of edged demo --stage
stage-title = 虚拟台架：演示中的双手
stage-what = 这些相机是虚拟的。在此完成真实单元中由双手完成的操作。
stage-board = 标定板为棋盘格，内角点 { $columns } × { $rows }；方格边长 { $mm } mm。
stage-show-board = 手持标定板
stage-show-part = 放置工件
stage-show-nothing = 清空
stage-lay = 把工件放到别处
stage-truth = 最近结果的偏差：X { $x } µm，Y { $y }，Z { $z }。
stage-truth-none = 单元测量工件后，误差显示在此。
stage-hand = 把标定板移到虚线处
stage-still = 放下标定板
stage-follow = 跟随虚线位置
stage-wave-left = 在左相机前挥手
stage-wave-right = 在右相机前挥手
stage-ring-left = 左镜头对焦环
stage-ring-right = 右镜头对焦环
stage-ring = 四分之一圈的 { $turn }

## A picture that is looked at closely
zoom = 缩放
zoom-in = 放大
zoom-out = 缩小
zoom-all = 全部

## Drafts
draft-begun = 之前开始的
draft-go-on = 继续
draft-go-on-with = 继续 { $name }
draft-discard = 丢弃
draft-discard-name = 丢弃 { $name }
draft-discard-title = 丢弃 { $name }？
draft-broken = 已无法读取。

## Keys
keys = 键盘
keys-steps = 到此编号的步骤
keys-beside = 到下一步、上一步
keys-main = 到底部的按钮
keys-undo = 撤销对草稿的最后更改
keys-redo = 重做
keys-close = 关闭已打开的内容
keys-list = 此列表
keys-ctrl = Ctrl
keys-single = 单键有效（输入文字时除外）

## Faults of cameras, by the PLC's number
fault-other = 单元故障。
fault-100 = 一台相机没有输出图像。
fault-101 = 找不到一台相机或它没有应答：请检查线缆和电源。
fault-102 = 一台相机正被另一台电脑控制。
fault-103 = 一台相机拒绝了某项设置。
fault-104 = 图像未按时到达：请检查触发、光照和线缆。
fault-105 = 图像损坏：网络中丢失了数据包。请检查线缆和交换机，并在“相机”页面测试数据包。
fault-106 = 两张图像不是同一次曝光。
fault-107 = 一台相机曾断电重启。
fault-108 = 这不是标定过的相机：线缆或地址接反了。
fault-109 = 一台相机重复发送了同一图像。
fault-110 = 一台相机不断发送同一图像。
fault-111 = 一台相机曝光了，另一台没有。
fault-112 = 一台相机有应答，但不发送图像。
fault-113 = 两次曝光之间有物体移动，或光照发生变化：工件必须静止。
measures-again = 单元会继续尝试：收到下一对完好的图像后恢复测量。
draft-settings = 已选定，尚未生效
draft-use = 使用这些设置
draft-put = 使其生效
draft-discarded = 草稿已丢弃。
draft-used = 单元正以这些设置运行。
diff-nothing = 无
diff-yes = 是
diff-no = 否
diff-option = { $name }：{ $before } → { $after }
diff-password = { $name }：另一个密码
