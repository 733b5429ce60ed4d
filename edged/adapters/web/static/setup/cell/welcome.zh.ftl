# Texts of welcome.js.
welcome-title = { $cell }：设置
welcome-new = 从拆箱的相机到抓取工件，共九步。打勾取决于单元已具备的内容，而不是点击。
welcome-complete = 单元已具备测量所需的一切。每一步都可以查看和重做。
welcome-done = 此处没有缺失。
welcome-facts = 单元已具备的内容
welcome-later = 用命令行完成
welcome-later-why = 这些步骤尚不能在浏览器中完成。命令见手册。
next-cameras = 下一步：相机
next-light = 下一步：光照和对焦
next-calibrate = 下一步：标定
next-check = 下一步：检查
next-teach = 下一步：示教工件
next-try = 下一步：试运行
next-robot = 下一步：机器人
next-plc = 下一步：PLC 和投运
fact-cameras = 相机
fact-cameras-found =
    { $count ->
        [0] 未找到
       *[other] 找到 { $count } 台
    }{ $troubled ->
        [0] { "" }
       *[other] ，其中 { $troubled } 台有问题
    }
fact-unknown = 尚未查看
fact-rig-sigma = （示教位置处 ±{ $sigma } µm）
fact-no-rig = 尚无
fact-no-jobs = 尚无
fact-plc = PLC
fact-plc-owner = 写入地址
fact-no-plc = 尚无写入
fact-machine = 本机
fact-machine-new = 尚未检查
fact-machine-found = { $bad } 项有问题，{ $warn } 项需查看
fact-machine-look = 查看
fact-error = 故障
manual-cameras = 如何设置相机
manual-light = 如何设置相机
manual-calibrate = 如何标定
manual-check = 如何验证
manual-teach = 如何示教
manual-try = 如何操作
manual-robot = 如何标定机器人
manual-plc = 如何连接 PLC
