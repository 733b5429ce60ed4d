# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = 本文へ移動
nav = ページ
nav-run = 運転
nav-setup = セットアップ
nav-jobs = ジョブ
nav-cycles = サイクル
nav-marks = マーク
nav-accept = 受入検査
nav-space = 3D
nav-settings = 設定
nav-system = システム
nav-manual = マニュアル
menu = アカウントと言語：
language = 言語
log-out = ログアウト
steps = ワークをつかむまでの手順
step-of = ステップ { $number }/{ $count }：
foot = 前後のステップ
understood = 了解
back = 戻る
left = 左
right = 右
state-starting = 起動中
state-ready = 準備完了
state-busy = 処理中
state-fault = 異常
state-stopping = 停止中
state-setup = SETUP 中
state-setup-by = { $name } が SETUP 中
state-setup-nobody = SETUP 中
plc-locked = AUTO_LOCK：設備がこのセルを使用中
plc-owner = PLC
plc-nobody = PLC 未接続
connection-lost = セルとの接続が切れました。再接続中です
field-limits = { $low }～{ $high } { $unit } の数値
field-number = 数値（例：0.5 または 0,5）

## Steps
step-welcome = はじめに
step-cameras = カメラ
step-light = 照明とピント
step-calibrate = キャリブレーション
step-check = 点検
step-teach = ティーチング
step-try = 試行
step-robot = ロボット
step-plc = PLC と運転開始
state-tick = 完了
state-doubt = 要確認
state-gap = 不足
state-open = 未着手
state-none = ここでは不明

## Who has the cell
lease = セルの使用者
lease-free = セルは設備のために測定しています。カメラを使うにはセルを取得してください。返却するまで、PLC には応答しません。
lease-incomplete = セルはまだ測定できません。取得してセットアップしてください。
lease-locked = 設備がこのセルを使用中です（AUTO_LOCK が 1）。だれも取得できません。まず設備を手動モードに切り替えてください。
lease-yours = セルはあなたが使用中です。返却するまで、設備のための測定は行いません。
lease-elsewhere = 別の画面であなたがセルを使用中です。ここで続けると、そちらは表示のみになります。
lease-others = { $name } がセルを使用中です。同じ画像と数値がリアルタイムで表示されます。
lease-others-view = { $name } がセルを使用中です。同じ画像と数値がリアルタイムで表示されます。変更できるのはエンジニアだけです。
lease-view = すべて閲覧できます。変更できるのはエンジニアだけです。
lease-unattended = セルは無人の状態です。中に人がいないことをだれかが確認するまで、測定は行いません。
lease-take = セルを取得
lease-take-over = 引き継ぐ
lease-continue = ここで続ける
lease-leave = 返却
lease-end = セットアップを終了
idle = { $name } さん、10 分間操作がなかったため、表示のみになっています。続けるにはパスワードを入力してください。
idle-wake = 操作を再開
confirm-title = パスワードの確認
confirm = { $name } さん、この操作は権限、またはセルが使うデータを変更します。続けるにはパスワードを入力してください。
confirm-yes = 続ける
password = パスワード
ask-take-title = セルを取得しますか？
ask-take = 実行中のサイクルが終わると READY が 0 になり、返却するまで PLC のコマンドはすべて拒否されます。
ask-take-yes = 取得する
ask-over-title = { $name } からセルを引き継ぎますか？
ask-over = { $name } に通知され、以後は表示のみになります。監査ログに記録されます。
ask-over-yes = 引き継ぐ
ask-leave-title = セルを返却しますか？
ask-leave = 有効な設定に戻り、テスト用の画像ペアを撮影してから READY になります。セル内に人がいないこと、ボードが残っていないことを確認してください。
ask-leave-yes = 返却する
ask-end-title = セル内は無人ですか？
ask-end = 目視で確認した場合だけ確定してください。セルは READY になり、設備が動き出すことがあります。
ask-end-yes = 確認しました：だれもいません

## What went wrong: cause and remedy
problem-other = できませんでした：{ $detail }
problem-unreachable = セルが応答しません。ネットワークケーブルとセルの PC を確認してください。自動で再試行します。
problem-page = このページを読み込めませんでした。セルが応答したら再読み込みしてください。
problem-log-in = ログアウトされています。もう一度ログインしてください。
problem-origin = どのページからの要求かをブラウザが示しませんでした。ページ本来のアドレスで開いてください。
problem-setup-refused = 今は実行できません：{ $detail }
problem-lease-lost = セルの使用権がなくなりました。現在の使用者は上の行のとおりです。それまでの作業は保存済みです。
problem-lease = セルの使用権がなくなりました。現在の使用者は上の行のとおりです。それまでの作業は保存済みです。
problem-role = あなたの権限では実行できません。エンジニアが実行できます。
problem-idle = 10 分間操作がありませんでした。パスワードをもう一度入力してください。
problem-password = パスワードが違います。
problem-confirm = パスワードの再入力が必要です。
problem-weak-password = このパスワードは推測されやすすぎます。自分の名前を含まない、複数の単語からなるものにしてください。
problem-exists = この名前、または見た目が同じ名前はすでに使われています。
problem-wait = 試行回数が多すぎます。{ $wait_s } 秒お待ちください。
problem-invalid = セルが受け付けません：{ $detail }
problem-unknown = 存在しないか、すでになくなっています。ページを再読み込みしてください。
problem-input = セルが受け付けません：{ $detail }
problem-storage = セルの PC のディスクがいっぱいです。空きを作ってから再試行してください。
problem-stale = その間に、ほかの人または別の画面で変更されました。新しい内容を表示しています。確認してから、もう一度変更してください。
problem-regression = 記録された良好なサイクルが不良になるか、まだ試されていません。「サイクル」のページで試し、そこから使用してください。
problem-teach-name = 名前として使えません。英字、数字、「_」「.」「-」を使い、英字か数字で始めてください。
problem-teach-name-taken = ジョブ { $name } はすでにあります。それを変更するか、別の名前にしてください。
problem-teach-number-taken = { $number } は { $name } の番号です。{ $free } は空いています。
problem-teach-name-old = この語尾の名前は置き換えられたジョブのものです。別の名前にしてください。
problem-image-size =
    { $side ->
        [left] 左
       *[right] 右
    }画像は { $found } 画素ですが、キャリブレーションは { $wanted } のものです。カメラの設定を戻すか、今の状態でキャリブレーションし直してください。
problem-task-failed = セルが完了できませんでした。再発する場合はログを確認してください(journalctl -u edged)。
problem-task-too-large = 必要なメモリまたは計算時間がセルの上限を超えたため停止しました。画像を減らすか小さくする、または小さい図面を使ってください。
problem-gone = この画像はもう保存されていません。撮影し直してください。
problem-status-404 = このセルにはその機能がありません。セルの PC の edged を更新してから、ページを再読み込みしてください。
problem-status-500 = セルの内部エラーです。ログを確認してください(journalctl -u edged)。

## Live pictures
live-left = 左カメラ（ライブ）
live-right = 右カメラ（ライブ）
live-waiting = 最初の画像を待っています。
live-watching = セルの使用者がカメラを見ると、画像が表示されます。
live-take = 画像なし：カメラを見るにはセルを取得してください。

## On several pages
fact-rig = キャリブレーション
fact-jobs = ジョブ
keep-what = これは試用です。保存しない限り、セルを返却すると元の設定に戻ります。
keep-calibrate = これらのカメラは試用です。キャリブレーションは以前のカメラで行われています。もう一度キャリブレーションすると、両方が一緒にセルのものになります。
keep = 保存する
kept = 保存しました。
board-title = どのボードですか？
board-recognise = 画像から認識する
board-state = 自分で指定する
board-kind = 種類
kind-chessboard = チェスボード
kind-charuco = ChArUco
kind-dots = ドットボード
kind-circles = 非対称サークル
board-columns = 1 行の内側コーナー（またはドット）数
board-rows = 行数
board-marker = マーカーの一辺
board-dictionary = マーカーの辞書
board-mm = マスの一辺
board-pitch = ドットの間隔
board-goal = 目標：測定空間内の 1 点で ±
board-proof = ノギスで多くのマスにわたって長さを測ってください。画像からは確かめられず、すべての座標がこの値に比例します。
board-begin = 開始
board-begin-auto = 開始し、自動で撮影する
board-still = ボードは静止しています。
board-moves = ボードをしばらく静止させてください。
view = ビュー { $name }

## What becomes a release, and who signs for it
release-note = 理由（後で見る人のために）
release-making = しばらくお待ちください…
sign-worse = 良好だった記録済みサイクル { $count } 件が不良になります。
sign-untried = 該当する記録済みサイクル { $count } 件では試されていません。
sign-look = 見る
sign-try = それらで試す
sign-what = 意図したものであれば理由を書いてください。理由はリリースとともに、またあなたの名前とともに監査ログに残ります。
sign-reason = 許容できる理由
sign = 署名：{ $label }

## The virtual stage of edged demo --stage
stage-title = 仮想ステージ：デモでのあなたの手
stage-what = カメラは仮想です。実際のセルで手が行うことをここで行います。
stage-board = ボードは内側コーナー { $columns } × { $rows } のチェスボードで、マスの一辺は { $mm } mm です。
stage-show-board = ボードを持つ
stage-show-part = ワークを置く
stage-show-nothing = 何もなし
stage-lay = ワークを別の場所に置く
stage-truth = 最新の結果のずれ：X { $x } µm、Y { $y }、Z { $z }。
stage-truth-none = セルがワークを測定すると、ここに誤差が表示されます。
stage-hand = ボードを破線の位置へ動かす
stage-still = ボードを置く
stage-follow = 破線の位置に追従する
stage-wave-left = 左カメラの前で手を振る
stage-wave-right = 右カメラの前で手を振る
stage-ring-left = 左レンズのリング
stage-ring-right = 右レンズのリング
stage-ring = 4 分の 1 回転の { $turn }

## A picture that is looked at closely
zoom = ズーム
zoom-in = 拡大
zoom-out = 縮小
zoom-all = 全体

## Drafts
draft-begun = 以前に始めたもの
draft-go-on = 続ける
draft-go-on-with = { $name } を続ける
draft-discard = 破棄
draft-discard-name = { $name } を破棄
draft-discard-title = { $name } を破棄しますか？
draft-broken = 読み込めなくなっています。

## Keys
keys = キーボード
keys-steps = その番号のステップへ
keys-beside = 次のステップ、前のステップへ
keys-main = 下端のボタンへ
keys-undo = 下書きの最後の変更を元に戻す
keys-redo = やり直す
keys-close = 開いているものを閉じる
keys-list = この一覧
keys-ctrl = Ctrl
keys-single = 単独キーを有効にする（入力中を除く）

## Faults of cameras, by the PLC's number
fault-other = セルの異常です。
fault-100 = カメラから画像が届きませんでした。
fault-101 = カメラが見つからないか応答しません。ケーブルと電源を確認してください。
fault-102 = 別の PC がカメラを制御しています。
fault-103 = カメラが設定を受け付けません。
fault-104 = 画像が時間内に届きませんでした。トリガ、照明、ケーブルを確認してください。
fault-105 = 画像が壊れて届きました。ネットワークでパケットが失われています。ケーブルとスイッチを確認し、「カメラ」のページでパケットをテストしてください。
fault-106 = 2 枚の画像が同じ露光のものではありません。
fault-107 = カメラの電源が入れ直されました。
fault-108 = キャリブレーションしたカメラではありません。ケーブルかアドレスが入れ替わっています。
fault-109 = カメラが同じ画像を 2 回送りました。
fault-110 = カメラが同じ画像を送り続けています。
fault-111 = 片方のカメラだけが露光しました。
fault-112 = カメラは応答しますが、画像を送ってきません。
fault-113 = 2 回の露光の間に何かが動いたか、照明が変わりました。ワークは静止している必要があります。
measures-again = セルは試行を続けています。次に正常な画像ペアが届くと測定を再開します。
draft-settings = 選択済み（まだ有効ではない）
draft-use = この設定を使う
draft-put = 有効にする
draft-discarded = 下書きを破棄しました。
draft-used = セルはこの設定で動いています。
diff-nothing = なし
diff-yes = はい
diff-no = いいえ
diff-option = { $name }：{ $before } → { $after }
diff-password = { $name }：別のパスワード
